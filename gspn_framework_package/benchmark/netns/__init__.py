"""A robot team whose network fails: each node in its own network namespace, a bridge between
them, partitions, one-way drops and delay. ``python3 -m gspn_framework_package.benchmark.netns``;
see ``docs/faults.md``."""
