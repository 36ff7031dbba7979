"""Tests of the agreement: real replicas on a simulated network with faults, all from one seed.

Nothing here runs on a robot. ``test/simulation`` and the commands ``benchmarks.agreement``,
``benchmarks.agreement_cost``, ``benchmarks.agreement_search`` and ``benchmarks.mutants`` use it:

- ``world``: simulated time, network, disks and actions for a team of real replicas;
- ``plans``: small plans that together use every rule of the token game;
- ``schedule``: one run from a seed, which injects faults and checks the outcome;
- ``process``, ``search``: what an adversary without a clock can do to a small team;
- ``traces``, ``trace_notes``, ``specification``: whether ``spec/agreement.tla`` allows what they do;
- ``mutants``: deliberate faults in the code, to confirm that a schedule catches them.
"""
