"""Solutions of a Markov chain: steady state, transient, first passage, measures.

Modules: ``anderson``, ``few_phases``, ``linear``, ``measures``, ``numba_sweeps``, ``ordering``,
``passage``, ``steady_state``, ``transient``.
"""
