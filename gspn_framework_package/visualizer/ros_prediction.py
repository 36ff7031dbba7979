"""Publishes on ROS whether a run matches the prediction of its plan."""

from __future__ import annotations

from typing import Sequence

import rospy
from diagnostic_msgs.msg import DiagnosticArray

from gspn_framework_package.analysis.monitoring.monitor import ALARM_EVERY, DAY
from gspn_framework_package.analysis.monitoring.streams import Alarm
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.msg import Prediction
from gspn_framework_package.ros.diagnostics import diagnostic_array
from gspn_framework_package.ros.messages import stamped_message
from gspn_framework_package.visualizer.live_comparison import Departures

PREDICTION_TOPIC = "/gspn_prediction"
"""All pages on a master publish on this topic; each message names its run."""


class RosPrediction:
    """Publishes ``/gspn_prediction`` (Prediction, latched), and a diagnosis on ``/diagnostics``."""

    def __init__(self) -> None:
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
        self._prediction = rospy.Publisher(PREDICTION_TOPIC, Prediction, latch=True, queue_size=1)

    def publish(self, plan: Plan, run: str, found: Departures) -> None:
        """Publish.

        :param plan: the plan that the run is compared with.
        """
        for alarm in found.new:
            rospy.logwarn("the run departs from the plan: %s", alarm.describe())
        self._prediction.publish(
            stamped_message(
                Prediction,
                run=run,
                plan=plan.hash(),
                departs=bool(found.lasting),
                alarms=[alarm.describe() for alarm in found.lasting],
                false_alarm_every=ALARM_EVERY,
                streams=[name for name, _ in found.levels],
                levels=[level for _, level in found.levels],
            )
        )
        if self._diagnostics.get_num_connections():
            self._diagnostics.publish(_diagnosis(plan, run, found.lasting))


def _diagnosis(plan: Plan, run: str, lasting: Sequence[Alarm]) -> DiagnosticArray:
    values = {
        "alarms": len(lasting),
        "false alarms": "one in %g days" % (ALARM_EVERY / DAY),
    }
    for alarm in lasting:
        about = ", ".join(p for p in (alarm.place, alarm.robot) if p) or "team"
        values[about] = alarm.describe()
    return diagnostic_array(
        "%s: gspn prediction, run %s" % (rospy.get_name(), run),
        plan.name,
        1 if lasting else 0,
        "; ".join(alarm.describe() for alarm in lasting[:3]) or "the run matches the prediction",
        values,
    )
