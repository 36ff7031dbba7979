"""What runs teach about a plan: how long its actions take, and how they end.

Modules: ``durations``, ``learning``, ``testing``.
"""

from gspn_framework_package.analysis.fitting.durations import DurationFit, Sample, fit_duration
from gspn_framework_package.analysis.fitting.learning import (
    EventFit,
    FamilyChoice,
    FitReport,
    OutcomeFit,
    PlaceFit,
    fit_plan,
)

__all__ = [
    "FamilyChoice",
    "DurationFit",
    "EventFit",
    "FitReport",
    "OutcomeFit",
    "PlaceFit",
    "Sample",
    "fit_duration",
    "fit_plan",
]
