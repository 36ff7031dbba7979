"""An order of the operator: a robot greets somebody, which the log keeps as a task."""

from gspn_framework_package.execution.log_entries import Submit, make_submit
from gspn_framework_package.model.errors import DataError
from gspn_framework_package.team.order_fields import FieldKind, OrderField
from gspn_framework_package.team.orders import ROBOT_FIELD, Form, OrderKind


def greeting(robot: str, whom: str) -> Submit:
    """The log entry. :raises DataError: the name is too long."""
    if len(whom) > 200:
        raise DataError("nobody has so long a name")
    return make_submit("greet", robot, {"whom": whom})


GREET = OrderKind(
    "have a robot greet somebody",
    (
        ROBOT_FIELD,
        OrderField("whom", FieldKind.TEXT, "who is greeted", required=False, default="everybody"),
    ),
    greeting,
    example="robot_2 --whom ann",
    noun="greeting",
    form=Form("more", "Greet", "It greets somebody.", "Have {robot} greet {whom}"),
)
