"""Numeric methods for the decision problem of a plan. Each returns certified bounds."""

from gspn_framework_package.analysis.decisions.solving.constrained import Constrained, constrained
from gspn_framework_package.analysis.decisions.solving.evaluate import Evaluated, evaluate
from gspn_framework_package.analysis.decisions.solving.optimum import Solved, optimum
from gspn_framework_package.analysis.decisions.solving.robust import Robust, robust
from gspn_framework_package.analysis.decisions.solving.sensitivities import sensitivities

__all__ = [
    "Constrained",
    "Evaluated",
    "Robust",
    "Solved",
    "constrained",
    "evaluate",
    "optimum",
    "robust",
    "sensitivities",
]
