"""Analysis: structure, state space, Markov chains, simulation. Model in, result objects out; no
ROS, no files."""
