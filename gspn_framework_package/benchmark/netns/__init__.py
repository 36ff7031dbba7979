"""A robot team whose network fails: each node runs in its own network namespace, connected by a
bridge with partitions, one-way drops and delay.
``python3 -m gspn_framework_package.benchmark.netns``; see ``docs/faults.md``."""
