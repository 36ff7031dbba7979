"""What is learned from runs of a plan: how long its actions take, and how they end.

Modules: ``arrivals``, ``durations``, ``learning``, ``needs``, ``sample``, ``testing``.
"""

from gspn_framework_package.analysis.fitting.arrivals import ArrivalsFit, with_day
from gspn_framework_package.analysis.fitting.durations import (
    DurationFit,
    family_choices,
    fit_duration,
)
from gspn_framework_package.analysis.fitting.learning import FitReport, PlaceFit, fit_plan
from gspn_framework_package.analysis.fitting.needs import Need
from gspn_framework_package.analysis.fitting.sample import Sample
from gspn_framework_package.analysis.fitting.testing import EventFit, OutcomeFit

__all__ = [
    "ArrivalsFit",
    "DurationFit",
    "EventFit",
    "FitReport",
    "Need",
    "OutcomeFit",
    "PlaceFit",
    "Sample",
    "family_choices",
    "fit_duration",
    "fit_plan",
    "with_day",
]
