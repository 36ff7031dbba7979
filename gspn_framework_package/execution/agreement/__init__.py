"""Agreement: every replica of a team sees one valid sequence of firings. No ROS in here.

*Protocol.* A run is a log of batches of entries, which every replica reduces with the same
deterministic token game; what is agreed on is the next batch. Each slot of the log is decided by
single-decree Paxos among the members that the log before it names; more than half of them decide,
or half with the first one. In full synchronisation a promise holds for all later slots too, so that
whoever got a batch chosen leads on without a first phase, until another takes over. In partial
synchronisation nobody leads: a robot makes local transitions, which concern it alone, without
asking, and for all else asks *every* member, whose answers bring those transitions into the log
first.

*Assumptions.* Messages may be lost, repeated, reordered and delayed, but are not forged. A process
may stop at any point, pause and return; what it had written before is there, or else it knows that
its log is lost. To go on, not to be safe, the team needs a quorum that runs and hears each other
most of the time.

*Why it is safe.* Members of a slot follow from the log before it, two quorums meet, votes are
written before they are told, and a proposer adopts what was accepted under the highest ballot that
it is told: so no slot has two values. A robot that lost its log votes only in slots after its
``Join``, and its former votes were for slots before: so no slot sees two memories. Proposals carry
who made them and a number that counts up: so none has an effect twice. Local transitions have one
writer and commute with all others.

All of this at length, and how it was tested: ``docs/agreement.md``. A replica is put together from
parts, each in a module that says what it owns and whom it calls:

- ``replica`` takes inputs and gives each to the part whose it is; ``interface``: inputs and
  effects, the border to whoever hosts a replica; ``messages``: what replicas say to each other;
- ``config``: what a replica is told once; ``state``: what it remembers, each field with one owner;
- ``outbox``: effects on their way out; ``electorate``: whose votes count, asked by all, changed by
  nobody;
- ``consensus``: Paxos for the first open slot; ``proposer``: when to propose, ask again and give
  way; ``proposals``: what waits to get into the log;
- ``replication``: slots that are decided, catching up, snapshots; ``recovery``: the own log, read
  back;
- ``membership``: hello, lives and memories, joining, leaving, eviction;
- ``local_robot``: goals, local transitions; ``orders``: what operators want; ``status``: what
  people may ask;
- ``quorum``, ``peers``, ``recent_slots``, ``local_transitions``: what these are made of.
"""
