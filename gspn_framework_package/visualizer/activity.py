"""Activities: one activity at a time feeds the hub of an open net.

Each activity takes *commands* from the page. A command is a name and JSON fields; an invalid one
raises a :class:`~gspn_framework_package.model.errors.GspnError`, which the page shows.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, Mapping, Optional

from gspn_framework_package.analysis.preflight.report import PreflightReport
from gspn_framework_package.model.errors import RefusedError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.deploy_team import DeployOutcome, Votes
from gspn_framework_package.visualizer.hub import Hub

RequestFields = Mapping[str, Any]
Handler = Callable[[RequestFields], Dict[str, Any]]


class Activity:
    """Base of all activities.

    :cvar mode: its name on the page.
    """

    mode = ""

    def __init__(self) -> None:
        self.commands: Dict[str, Handler] = {}

    @property
    def log(self) -> Optional[str]:
        """The path of the event log of the run shown; None if this server has none."""
        return None

    @property
    def running(self) -> Optional[bool]:
        """Whether a plan is being executed; None: the status of the board decides."""
        return None

    def plan_of(self, number: int) -> Optional[Plan]:
        """The plan with this number, which the run shown followed at some point (see
        :mod:`~gspn_framework_package.visualizer.board`); None if there is none."""
        return None

    def after_slot(self, slot: int) -> Optional[int]:
        """The number of the last event of a slot of the log that is shown; None if unknown so
        far."""
        return None

    def verdict(self, plan: Plan) -> PreflightReport:
        """The check's report on a plan to deploy.

        :raises GspnError: it is not a valid plan, or none can be deployed here.
        """
        raise RefusedError("no plan can be deployed here", hint="start a run first")

    def deploy(
        self, plan: Plan, mapping: Mapping[str, str], tell: Callable[[Votes], None]
    ) -> DeployOutcome:
        """Make the run follow another plan; this may take a while. An activity that can do this
        lists ``deploy`` among its commands.

        :param mapping: names of the present net -> their names in ``plan``.
        :param tell: receives the votes whenever they change.
        :raises GspnError: the plan is refused.
        """
        raise RefusedError("no plan can be deployed here", hint="start a run first")

    def begin(self, hub: Hub) -> None:
        """Start feeding ``hub``, which begins a new epoch."""
        raise NotImplementedError

    def end(self) -> None:
        """Release the hub and every other resource. May be called twice."""

    def command(self, name: str, fields: RequestFields) -> Dict[str, Any]:
        """Execute a command of the page. :raises UsageError: this activity has no such command."""
        handler = self.commands.get(name)
        if handler is None:
            raise UsageError(
                "'%s' cannot be done here" % name[:40],
                hint="possible: %s" % (", ".join(sorted(self.commands)) or "nothing"),
            )
        return handler(fields)


def whole_field(fields: RequestFields, key: str, default: int, low: int, high: int) -> int:
    """Return the whole number in the field ``key`` of a command, or ``default``.

    :raises UsageError: it is not a whole number from ``low`` to ``high``.
    """
    value = fields.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise UsageError("'%s' must be a whole number from %d to %d" % (key, low, high))
    return value


def text_field(fields: RequestFields, key: str, default: Optional[str] = None) -> str:
    """Return the text in the field ``key`` of a command.

    :param default: the value of a missing field; None: the field is required.
    :raises UsageError: it is missing, or not a text.
    """
    value = fields.get(key, default)
    if not isinstance(value, str):
        raise UsageError("'%s' is missing" % key)
    return value
