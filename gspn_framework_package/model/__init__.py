"""The model: net, marking, policy, plan, errors. Immutable values, no I/O, no ROS.

Modules: ``action``, ``builder``, ``capacity``, ``compact_json``, ``composition``, ``condition``,
``constants``, ``data``, ``duration``, ``errors``, ``event``, ``expression``, ``kept``,
``message_condition``, ``net``, ``outcome``, ``plan``, ``plan_timing``, ``policy``,
``robot_colours``, ``subnet``.
"""
