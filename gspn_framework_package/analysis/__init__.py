"""Analysis: structure, state space, Markov chains, simulation. Model in, result objects out; no
ROS, no files.

``analyse`` is the front door: all that can be asked of one net or plan; ``report`` and ``drawing``
put the answers into words and pictures, ``chain_export`` into the files of other tools. Behind it,
each folder building on those before it:

- ``structure``: what the arcs alone say: invariants, siphons, traps, classes, conflicts;
- ``state_space``: the reachable markings, by one of three engines; coverability; properties that
  are read off the graph (deadlocks, liveness, home states);
- ``plan``: the same for a plan under its policy;
- ``chain``: the Markov chain of a state space, vanishing markings eliminated;
- ``solution``: steady state, transient, first passage, and the measures that follow from them;
- ``simulation``: many runs of a net or a plan, with confidence intervals;
- ``preflight``: the check of a plan before any robot moves.

Shared by all: ``limits`` (how far a search goes), ``watch`` (progress, cancelling), ``graph``
(algorithms on graphs), ``compiling`` (numba).
"""
