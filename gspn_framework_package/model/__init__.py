"""The model: nets, markings, policies, plans and errors. Immutable values without I/O or ROS.

Modules: ``action``, ``attempt``, ``builder``, ``capacity``, ``compact_json``, ``composition``,
``condition``, ``constants``, ``data``, ``duration``, ``errors``, ``event``, ``expression``,
``failure``, ``families``, ``goal_pose``, ``kept``, ``marking_function``, ``message_condition``,
``net``, ``outcome``, ``plan``, ``plan_timing``, ``policy``, ``policy_cell``, ``robot_colours``,
``subnet``.
"""
