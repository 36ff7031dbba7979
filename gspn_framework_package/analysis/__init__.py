"""Analysis: structure, state space, Markov chains, simulation. Model in, result objects out; no
ROS, no files.

``analyse`` is the entry point: it answers every question about one net or plan. ``report``, with
the measures listed in ``report_measures``, ``report_rows`` and ``drawing`` turn the answers into
text and pictures, ``chain_export`` into files for other tools. ``intervals`` says how far the
answers may be off.
Behind it, each folder builds on those before it:

- ``structure``: properties of the arcs alone: invariants, siphons, traps, classes, conflicts;
- ``state_space``: the reachable markings, found by one of three engines; coverability; properties
  read off the graph (deadlocks, liveness, home states);
- ``plan``: the same for a plan under its policy;
- ``proofs``: what holds in all markings, with proofs that can be checked, and witnesses;
- ``queries``: temporal queries (CSL and CTL);
- ``symbolic``: how many markings there are, where they are too many to visit, by decision diagrams;
- ``chain``: the Markov chain of a state space, vanishing markings eliminated;
- ``solution``: steady state, transient, first passage, and the measures derived from them;
- ``simulation``: many runs of a net or a plan, with confidence intervals;
- ``preflight``: the check of a plan before any robot moves.

All of them share ``limits`` (of a search), ``watch`` (progress, cancellation), ``graph``
(graph algorithms), ``compiling`` (numba) and ``machine_code`` (its results, kept).

Also here: ``arrays``, ``decisions``, ``executors``, ``fitting``, ``monitoring``, ``on_disk``,
``quantiles``, ``sweeps``, ``symmetry``.
"""
