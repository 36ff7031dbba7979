"""A team anywhere: three machines behind two NATs, robots with and without ROS, faults, and an
attacker. ``python3 -m benchmarks.anywhere``; see ``docs/security.md``."""
