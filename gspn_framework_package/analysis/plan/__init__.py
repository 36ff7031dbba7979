"""Analysis of a plan beyond its net: the policy, the robots' own behaviour, places that only count.

Modules: ``completion``, ``edited_nets``, ``markings``, ``policy_answers``, ``reading``,
``run_net_export``, ``space`` (the states of the plan's run net), ``structure``, ``subnets``,
``witness``.
"""
