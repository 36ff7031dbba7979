"""Structural properties of a net: invariants, siphons, traps, classes, conflicts."""

from gspn_framework_package.analysis.structure.net_structure import (
    NetClasses,
    Structure,
    classify,
    conflict_sets,
)

__all__ = ["NetClasses", "Structure", "classify", "conflict_sets"]
