"""Starts a real team, watches it, and ends it, for benchmarks and for experiments with faults.

- ``programs``: processes of this machine, or in the namespaces of a network, that end together.
- ``team``: robots that execute a plan: ROS nodes, agents without ROS, or ``roslaunch``; what they
  do, what they need, and whether their logs are valid.
- ``master``: a ROS master on this machine, which can be killed and restarted.
- ``log_tail``: a robot's log while it is written.
- ``processes``, ``ports``: what processes cost; free ports.
- ``network``, ``gateways``, ``rules``, ``relay``: network namespaces, cuts, NATs, delays.
- ``master_sync``: a stand-in for ``fkie_multimaster``.
"""
