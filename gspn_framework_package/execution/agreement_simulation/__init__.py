"""The agreement under test: real replicas on a simulated network, with faults, from one seed.

Nothing here runs on a robot. ``test/simulation`` and the commands ``benchmark.agreement``,
``benchmark.agreement_cost`` and ``benchmark.mutants`` use it:

- ``world``: simulated time, network, disks and actions for a team of real replicas;
- ``plans``: small plans that between them use every rule of the token game;
- ``schedule``: one run under a seed: what goes wrong, and whether it came out right;
- ``mutants``: faults put into the code on purpose, to see that a schedule catches them.
"""
