"""Numeric methods for the decision problem of a plan. Each returns certified bounds."""

from gspn_framework_package.analysis.decisions.solving.evaluate import Evaluated, evaluate
from gspn_framework_package.analysis.decisions.solving.optimum import Solved, optimum

__all__ = ["Evaluated", "Solved", "evaluate", "optimum"]
