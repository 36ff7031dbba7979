"""Agreement: every replica of a team sees one valid sequence of firings. No ROS in here.

*Protocol.* A run is a log of batches of entries, which every replica reduces with the same
deterministic token game; the replicas agree on the next batch. Single-decree Paxos decides each
slot of the log, among the members that the log before it names; more than half of them decide, or
half including the first one. In full synchronisation a promise also holds for all later slots, so
the robot that got a batch chosen leads without a first phase until another takes over. In partial
synchronisation nobody leads: a robot makes local transitions, which concern it alone, without
asking. For everything else it asks *every* member, and the answers bring those transitions into
the log first.

*Assumptions.* Messages may be lost, duplicated, reordered and delayed, but are not forged. A
process may stop at any point, pause and return; what it wrote before is there, or else it knows
that its log is lost. For progress (not for safety) the team needs a quorum that runs and hears each
other most of the time.

*Why it is safe.* Members of a slot follow from the log before it, two quorums intersect, votes are
written before they are sent, and a proposer adopts the value accepted under the highest ballot that
is reported to it; so no slot has two values. A robot that lost its log votes only in slots after
its ``Join``, and its former votes were for slots before; so no slot sees two memories. Proposals
carry their author and a sequence number, so none has an effect twice. Local transitions have one
writer and commute with all others.

``docs/agreement.md`` has the details and how it was tested. A replica is assembled from parts; each
part's module says what it owns and whom it calls:

- ``replica`` routes each input to the part that handles it; ``interface``: inputs and effects, the
  border to the host of a replica; ``messages``: what replicas send each other;
- ``config``: a replica's configuration; ``state``: what it remembers, each field with one owner;
- ``outbox``: effects on their way out; ``electorate``: whose votes count, asked by all, changed by
  nobody;
- ``consensus``: Paxos for the first open slot; ``proposer``: when to propose, ask again and give
  way; ``proposals``: what waits to get into the log;
- ``replication``: decided slots, catching up, snapshots; ``recovery``: the own log, read back;
- ``membership``: hello, incarnations and memories, joining, leaving, eviction;
- ``local_robot``: goals, local transitions; ``orders``: operators' orders; ``status``: answers for
  people;
- ``quorum``, ``peers``, ``recent_slots``, ``local_transitions``: the building blocks of these.

Also here: ``deployment``, ``reactions``.
"""
