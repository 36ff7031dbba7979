"""An oracle for what a plan means while it runs.

The package states that meaning more than once: in the run itself, in the chain, in the simulation,
in the check and in the optimiser. Here small plans, each aimed at one rule, are put to all of them,
and what they say is compared; where both are exact, to the last digits. Mutants show that the plans
find a wrong rule.

``numbers`` defines what a statement has to offer (``Steps``) and makes numbers of it that can be
compared; ``run_steps`` has the run itself as such steps, ``old`` the other statements. ``comparing``
compares two statements, ``plans`` makes the plans, ``mutants`` breaks each rule in each statement
that has it (``mutant`` says how). The command is ``test/campaigns/meaning.py``.
"""
