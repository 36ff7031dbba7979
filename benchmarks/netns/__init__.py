"""A robot team whose network fails: each node runs in its own network namespace, connected by a
bridge with partitions, one-way drops and delay.
``python3 -m benchmarks.netns``; see ``docs/faults.md``."""
