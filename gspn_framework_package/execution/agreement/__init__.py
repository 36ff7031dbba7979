"""Agreement: every replica of a team sees one valid sequence of firings. No ROS in here.

*Protocol.* A run is a log of batches of facts, which every replica reduces with the same deterministic token game;
what is agreed on is the next batch. Each slot of the log is decided by single-decree Paxos among the members that the
log before it names; more than half of them decide, or half with the first one. In full synchronisation a promise
holds for all later slots too, so that whoever got a batch chosen leads on without a first phase, until another takes
over. In partial synchronisation nobody leads: a robot makes moves that concern it alone without asking, and for all
else asks *every* member, whose answers bring those moves into the log first.

*Assumptions.* Messages may be lost, repeated, reordered and delayed, but are not forged. A process may stop at any
point, pause and return; what it had written before is there, or else it knows that its log is lost. To go on, not to
be safe, the team needs a quorum that runs and hears each other most of the time.

*Why it is safe.* Members of a slot follow from the log before it, two quorums meet, votes are written before they are
told, and a proposer adopts what was accepted under the highest ballot that it is told: so no slot has two values. A
robot that lost its log votes only in slots after its ``Join``, and its former votes were for slots before: so no slot
sees two memories. Facts carry who said them and a number that counts up: so none has an effect twice. Private moves
have one writer and commute with all others.

All of this at length, and how it was tested: ``docs/agreement.md``. Where things are:

- ``interface``: inputs and effects, the border to whoever hosts a replica;
- ``consensus``: Paxos for the first open slot (``quorum``: ballots and quorums; ``host``: what it
  needs of the replica);
- ``replica``: the step function, which stands on ``pacing`` (what is due as time passes),
  ``conduct`` (actions and orders at this robot), ``meeting`` (hello), ``growth`` (slots that are
  decided, caught up on, read back) and ``core`` (what all of them share);
- ``pool``: facts on their way; ``own_robot`` and ``private``: this robot and its private moves;
  ``peers``: who was heard when; ``catch_up``: the newest slots, for those who are behind.
"""
