"""Computes policies: from a plan to its decision problem, to the best policy for an aim with
certified bounds, and back to a table in the plan's format.

Modules: ``aims``, ``automaton``, ``building``, ``decisions``, ``export``, ``grouping``,
``optimise``, ``playing``, ``problem``, ``report``, ``rolling``, ``rollout``, ``run_net``,
``safety``, ``solving``, ``who_decides``.
"""
