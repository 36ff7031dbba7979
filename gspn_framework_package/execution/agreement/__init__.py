"""Agreement: every replica of a team sees one valid sequence of firings. No ROS in here.

Protocol, assumptions and a sketch of the proof: ``docs/agreement.md``. Where things are:

- ``interface``: inputs and effects, the border to whoever hosts a replica;
- ``consensus``: Paxos for the first open slot (``quorum``: ballots and quorums; ``host``: what it
  needs of the replica);
- ``replica``: the step function, which stands on ``pacing`` (what is due as time passes),
  ``conduct`` (actions and orders at this robot), ``meeting`` (hello), ``growth`` (slots that are
  decided, caught up on, read back) and ``core`` (what all of them share);
- ``pool``: facts on their way; ``own_robot`` and ``private``: this robot and its private moves;
  ``peers``: who was heard when; ``catch_up``: the newest slots, for those who are behind.
"""
