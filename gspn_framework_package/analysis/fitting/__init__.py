"""What is learned from runs of a plan: how long its actions take, and how they end.

Modules: ``durations``, ``learning``, ``needs``, ``sample``, ``testing``.
"""

from gspn_framework_package.analysis.fitting.durations import (
    DurationFit,
    family_choices,
    fit_duration,
)
from gspn_framework_package.analysis.fitting.learning import (
    EventFit,
    FitReport,
    OutcomeFit,
    PlaceFit,
    fit_plan,
)
from gspn_framework_package.analysis.fitting.needs import Need
from gspn_framework_package.analysis.fitting.sample import Sample

__all__ = [
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
]
