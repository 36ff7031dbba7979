"""Structural properties of a net: invariants, siphons, traps, classes, conflicts."""
