"""Structural properties of a net: invariants, siphons, traps, classes, conflicts.

Modules: ``incidence``, ``invariants``, ``net_structure``, ``siphons``.
"""
