"""Numeric methods for the decision problem of a plan. Each returns certified bounds.

Modules: ``bounded``, ``constraints``, ``end_classes``, ``evaluation``, ``fixed_point``, ``graphs``,
``layers``, ``model``, ``numba_sweeps``, ``optima``, ``robustness``, ``sensitivity``, ``solved``.
"""

from gspn_framework_package.analysis.decisions.solving.constraints import Constrained, constrained
from gspn_framework_package.analysis.decisions.solving.evaluation import (
    Evaluated,
    evaluate_policy,
    follow_policy,
)
from gspn_framework_package.analysis.decisions.solving.optima import optimum
from gspn_framework_package.analysis.decisions.solving.robustness import Robust, robust
from gspn_framework_package.analysis.decisions.solving.sensitivity import sensitivities
from gspn_framework_package.analysis.decisions.solving.solved import Solved

__all__ = [
    "Constrained",
    "Evaluated",
    "Robust",
    "Solved",
    "constrained",
    "evaluate_policy",
    "follow_policy",
    "optimum",
    "robust",
    "sensitivities",
]
