"""Computes policies: from a plan to its decision problem, to the best policy for an aim with
certified bounds, and back to a table in the plan's format.

Modules: ``aims``, ``automaton``, ``building``, ``decision_net``, ``decisions``, ``export``,
``grouping``, ``net_choices``, ``optimise``, ``playing``, ``problem``, ``report``, ``rolling``,
``rollout``, ``safety``, ``solving``, ``storm``, ``who_decides``.
"""
