"""A robot team whose network fails: each node in a network namespace of its own, a bridge between
them, partitions, one-way drops and delay. ``python3 -m gspn_framework_package.benchmark.netns``;
see ``docs/faults.md``."""
