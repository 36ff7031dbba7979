"""Solutions of a Markov chain: steady state, transient, first passage, measures."""
