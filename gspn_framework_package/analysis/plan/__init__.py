"""Analysis of a plan beyond its net: the policy, the robots' own behaviour, places that only count.

Modules: ``completion``, ``markings``, ``phases``, ``reading``, ``rules``, ``run_rules``,
``space``, ``structure``, ``subnets``, ``witness``.
"""
