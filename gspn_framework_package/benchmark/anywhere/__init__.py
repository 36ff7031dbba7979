"""A team anywhere: three machines behind two NATs, robots with and without ROS, faults, and an
attacker. ``python3 -m gspn_framework_package.benchmark.anywhere``; see ``docs/security.md``."""
