"""The agreement protocol: every replica of a team sees the same valid sequence of firings. Nothing
here imports ROS.

*Protocol.* A run is a log of batches of entries, which every replica reduces with the same
deterministic token game; the replicas agree on the next batch. Single-decree Paxos decides each
slot of the log among the members named by the log before it; a quorum is more than half of them, or
exactly half including the first. In full synchronisation a promise also holds for all later slots,
so the robot whose batch was chosen leads without a first phase until another takes over. In partial
synchronisation there is no leader: a robot makes local transitions, which affect no other robot,
without asking. For everything else it asks *every* member, and the answers first bring those
transitions into the log.

*Assumptions.* Messages may be lost, duplicated, reordered and delayed, but are not forged. A
process may stop, pause and return at any point; either what it wrote before is intact, or it knows
that its log is lost. Progress (but not safety) requires a quorum that is running and connected most
of the time.

*Why it is safe.* Members of a slot follow from the log before it, two quorums intersect, votes are
written before they are sent, and a proposer adopts the value accepted under the highest ballot
reported to it; so no slot has two values. A robot that lost its log votes only in slots after its
``Join``, and its former votes were for earlier slots; so no slot counts votes from both memories.
Proposals carry their author and a sequence number, so none takes effect twice. Local transitions
have one writer and commute with all others.

``docs/agreement.md`` has the details and how it was tested. A replica is assembled from parts; the
docstring of each part's module says what it owns and what it calls:

- ``replica`` routes each input to the part that handles it; ``interface``: inputs and effects, the
  interface to a replica's host; ``messages``: the messages between replicas;
- ``config``: a replica's configuration; ``state``: its state, each field with one owner;
- ``outbox``: collects effects; ``electorate``: whose votes count (read-only, used by all parts);
- ``consensus``: Paxos for the first open slot; ``proposer``: when to propose, retry and give way;
  ``proposals``: entries waiting to get into the log;
- ``replication``: decided slots, catching up, snapshots; ``recovery``: reads a replica's own log at
  a restart;
- ``membership``: hello, incarnations and memories, joining, leaving, eviction;
- ``local_robot``: goals, local transitions; ``orders``: operators' orders; ``status``: reports for
  people;
- ``quorum``, ``peers``, ``recent_slots``, ``local_transitions``: the building blocks of these.

Also here: ``deployment``, ``reactions``, and ``part``, the base of all that hold the others.
"""
