"""The orders and questions of an operator: a row of :data:`ORDERS` for each.

Whoever handles orders reads this table: the command line makes its verbs of the rows, a robot reads
and answers requests by them (:mod:`~gspn_framework_package.team.commands`), and the page's server
checks what viewers order and describes the orders to the page's JavaScript.

A request has the name of the order, perhaps a robot, and a text ``argument`` (see
``srv/Command.srv``). :meth:`OrderKind.argument` writes that text and :meth:`OrderKind.read` reads
it.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.model.compact_json import compact
from gspn_framework_package.model.errors import DataError, RefusedError
from gspn_framework_package.team.order_fields import FieldKind, OrderField

if TYPE_CHECKING:
    from gspn_framework_package.model.plan import Plan
    from gspn_framework_package.team.carrier import OperatorRequest
    from gspn_framework_package.team.host import ReplicaHost

ORDER_TIME = 5.0
"""Seconds within which an operator's order must get into the log."""

ADOPT_TIME = 20.0
"""The same for an order to adopt a plan, which is first checked in a separate process."""

PAGE, SUBMITTED = "page", "submitted"
"""Where an order comes from: the page, or anywhere else."""


class Form(NamedTuple):
    """How the page offers an order, with another button for each flag that has a label.
    ``{robot}``, ``{place}`` and so on stand for the fields,
    ``{run}`` for the run, ``{team}`` for its robots, ``{state}`` for what the robot does.

    :ivar where: ``header``; the card of a robot that is ``running``, ``paused`` or ``failed``, or
        ``more`` for the rarer orders there; or, of a ``transition``, ``entrance`` or ``node``, the
        inspector; or a ``task``, wherever it is shown.
    :ivar label: the text of its button, and ``about`` a description.
    :ivar says: what is ordered, for the list of orders.
    :ivar title: the title of a dialog that asks for the other fields, or whether it is meant; ""
        for no dialog. ``text`` stands in it, ``confirm`` on its button.
    :ivar style: of the button: ``primary``, ``danger``, both or neither.
    """

    where: str
    label: str = ""
    about: str = ""
    says: str = ""
    title: str = ""
    text: str = ""
    confirm: str = ""
    style: str = ""


class Asks(enum.Enum):
    """Whether a request is a question, which changes nothing, and every watcher may ask it."""

    NEVER = enum.auto()
    ALWAYS = enum.auto()
    WITHOUT_ARGUMENT = enum.auto()


class OrderKind(NamedTuple):
    """An order, or a question.

    :ivar help: what it does, in one line.
    :ivar entry: makes its log entry of the values of the fields.
    :ivar answer: of what makes no log entry, answers instead, on the robot's worker thread; returns
        a text or a JSON object, or raises a GspnError.
    :ivar example: words after the verb on the command line; None: there is no such verb.
    :ivar note: more about the verb.
    :ivar noun: what its argument is, for messages; ``like`` is an example of it.
    :ivar seconds: how long a robot may take to carry it out.
    :ivar word: what the command line says when it is carried out.
    :ivar against_robot: whether the robot that it concerns is the last to ask.
    """

    help: str
    fields: Tuple[OrderField, ...] = ()
    entry: Optional[Callable[..., log_entries.Ordered]] = None
    answer: Optional[Callable[..., Any]] = None
    asks: Asks = Asks.NEVER
    example: Optional[str] = None
    note: str = ""
    noun: str = ""
    like: str = ""
    seconds: float = ORDER_TIME
    word: str = "done"
    against_robot: bool = False
    form: Optional[Form] = None

    def values(
        self, given: Mapping[str, Any], source: str, plan: Optional[Plan] = None
    ) -> Dict[str, Any]:
        """The value of every field, checked.

        :param given: field -> its value.
        :param source: where the order comes from.
        :param plan: has to have the places and transitions; None if it is not known.
        :raises GspnError: a field is missing, or its value is refused.
        """
        return {f.name: f.value(given.get(f.name), source, plan) for f in self.fields}

    def checked(
        self, given: Mapping[str, Any], source: str, plan: Optional[Plan] = None
    ) -> Dict[str, Any]:
        """As :meth:`values`, but also check that they make a log entry."""
        values = self.values(given, source, plan)
        if self.entry is not None:
            self.entry(**values)
        return values

    def read(self, robot: str, argument: str, here: str) -> Dict[str, Any]:
        """The values of the fields in a request.

        :param here: the robot that is asked, which a request without a robot concerns.
        :raises GspnError: it cannot be read.
        """
        inside = self._inside
        if self.asks is Asks.WITHOUT_ARGUMENT and not argument:
            return dict.fromkeys(field.name for field in inside)
        needs_robot = any(f.kind is FieldKind.ROBOT and f.required for f in self.fields)
        given: Dict[str, Any] = {"robot": robot or (here if needs_robot else "")}
        if len(inside) == 1:
            given[inside[0].name] = inside[0].read(argument)
        elif inside:
            from gspn_framework_package.team.message_filter import json_object

            found, names = json_object(argument), [field.name for field in inside]
            if found is None or not set(found) <= set(names):
                raise DataError(
                    "%.100r is not a JSON object with %s and %s"
                    % (argument, ", ".join(names[:-1]), names[-1]),
                    hint="for example %s" % self.like,
                )
            given.update(found)
        return self.values(given, SUBMITTED)

    def argument(self, values: Mapping[str, Any]) -> str:
        """The ``argument`` of a request: a text unchanged, other values as JSON,
        several as a JSON object, without empty texts and zeros that need not be given."""
        inside = self._inside
        if len(inside) != 1:
            left_out = [f.name for f in inside if not f.required and values[f.name] in ("", 0)]
            given = {f.name: values[f.name] for f in inside if f.name not in left_out}
            return compact(given) if inside else ""
        value = values[inside[0].name]
        if inside[0].kind is FieldKind.FLAG:
            return inside[0].name if value else ""
        return value if isinstance(value, str) else "" if value is None else compact(value)

    @property
    def _inside(self) -> List[OrderField]:
        """The fields that travel in the argument."""
        return [field for field in self.fields if field.kind is not FieldKind.ROBOT]

    def is_question(self, argument: str) -> bool:
        """Whether a request with this argument changes nothing."""
        if self.asks is Asks.WITHOUT_ARGUMENT:
            return not argument
        return self.asks is Asks.ALWAYS


def _stage(plan: Dict[str, Any], map: Dict[str, str], folder: str) -> log_entries.Ordered:
    """:raises LogError: the plan or the names are not of the right form."""
    from gspn_framework_package.execution.plan_change import digest_of

    entry = log_entries.checked(log_entries.StagePlan(plan, digest_of(plan), map, folder))
    assert isinstance(entry, log_entries.StagePlan)
    return entry


def _adopted(worker: ReplicaHost) -> Dict[str, Any]:
    found = worker.adopted()
    if found is None:
        raise RefusedError("the team still follows its first plan")
    return found.to_json()


ROBOT_FIELD = OrderField("robot", FieldKind.ROBOT, "name of the robot")
ROBOT_OR_TEAM = ROBOT_FIELD._replace(help="name of the robot; default: the team", required=False)
TASK_FIELD = OrderField("id", FieldKind.ID, "id of the task", label="Id")
STAGE_FIELD = OrderField(
    "stage", FieldKind.NUMBER, "number of the stage", required=False, default=-1
)

ORDERS: Dict[str, OrderKind] = {
    "status": OrderKind(
        "show what every robot of a running team does and waits for",
        (OrderField("data", FieldKind.TEXT, required=False),),
        answer=lambda worker, data: worker.status(data),
        asks=Asks.ALWAYS,
        example="",
    ),
    "pause": OrderKind(
        "stop all firing until resume, or the firings of one robot; actions continue",
        (
            ROBOT_OR_TEAM,
            OrderField(
                "stop",
                FieldKind.FLAG,
                "stop the actions as well: they are cancelled, and start again on resume",
                required=False,
                default=False,
                label="Stop",
            ),
        ),
        lambda robot, stop: log_entries.Pause(robot, stop=stop),
        example="robot_2 --stop",
        note="Without --stop, running actions finish, and the robot then waits.",
        form=Form(
            "running",
            "Pause",
            "It takes part in no firing until it is resumed; its action continues",
            "Pause {robot}",
        ),
    ),
    "resume": OrderKind(
        "end a pause of the team, or of one robot",
        (ROBOT_OR_TEAM,),
        log_entries.Resume,
        example="robot_2",
        form=Form("paused", "Resume", says="Resume {robot}"),
    ),
    "evict": OrderKind(
        "remove a robot from the team as lost",
        (ROBOT_FIELD,),
        lambda robot: log_entries.Evict(robot, -1),
        example="robot_2",
        against_robot=True,
        form=Form(
            "more",
            "Evict",
            "Remove it from the team as lost, if it will not come back by itself.",
            "Evict {robot}",
            title="Evict {robot} from the run “{run}”?",
            text="{state} The team continues without it, and its token is taken out of the net. "
            "What it is doing is cancelled once it hears of that.",
            confirm="Evict {robot}",
            style="danger",
        ),
    ),
    "force_evict": OrderKind(
        "the same without a quorum: you assert that the robot is switched off",
        (ROBOT_FIELD,),
        lambda robot: log_entries.Evict(robot, -1, True),
        example="robot_2",
        against_robot=True,
    ),
    "trust": OrderKind(
        "continue without the robots that stay off after a loss of power",
        entry=lambda: log_entries.Evict("", -1, True),
        example="",
    ),
    "set_place": OrderKind(
        "put a robot into a place; its action there starts",
        (ROBOT_FIELD, OrderField("place", FieldKind.PLACE, "the place", label="Place")),
        log_entries.SetPlace,
        example="robot_2 Door",
        form=Form(
            "more",
            "Set place",
            "Set its place, for example after somebody carried it. The action there starts.",
            "Move {robot} to {place}",
        ),
    ),
    "retry": OrderKind(
        "try the failed action of a robot again",
        (ROBOT_FIELD,),
        log_entries.Retry,
        example="robot_2",
        form=Form(
            "failed",
            "Try again",
            "Start its action again",
            "Retry the action of {robot}",
            style="primary",
        ),
    ),
    "fire": OrderKind(
        "fire a transition of the environment",
        (OrderField("transition", FieldKind.TRANSITION, "the transition"),),
        log_entries.Fire,
        example="open_shop",
        form=Form(
            "transition",
            "Fire for the environment",
            "On behalf of the environment: no robot takes part",
            "Fire {transition}",
        ),
    ),
    "submit": OrderKind(
        "give a task to a running team",
        (
            OrderField("transition", FieldKind.ENTRANCE, "the transition that takes the task"),
            OrderField(
                "id",
                FieldKind.ID,
                "id of the task; of several tasks with the same id only the first counts (default: "
                "a new id)",
                required=False,
                default=log_entries.new_task_id,
                label="Id",
                placeholder="made up by the server",
            ),
            OrderField(
                "data",
                FieldKind.OBJECT,
                "the data of the task: a JSON object, a file that contains one, or - for standard "
                "input",
                required=False,
                default={},
                label="Data, a JSON object",
            ),
            OrderField(
                "priority",
                FieldKind.NUMBER,
                "tasks with a higher one come before others where they wait (default: 0)",
                required=False,
                default=0,
                label="Priority",
                placeholder="0",
            ),
            OrderField(
                "until",
                FieldKind.TIME,
                "if it still waits then, it is late, and nobody takes it any more: +10m, 17:30 or "
                "2026-11-27T17:30 (default: it waits as long as it takes)",
                required=False,
                default=0,
                label="Not begun after",
                placeholder="+10m or 17:30",
            ),
            OrderField(
                "replace",
                FieldKind.TEXT,
                "id of a task that is cancelled if the team takes this one in its place",
                required=False,
                label="Replaces the task",
                placeholder="the id of none",
            ),
            OrderField(
                "to",
                FieldKind.TEXT,
                "the only robot that may take it, or a capability that the plan lists for robots "
                "(default: any)",
                required=False,
                label="Only for the robot, or robots that can",
                placeholder="any",
            ),
            OrderField(
                "at",
                FieldKind.TIME,
                "when it comes in, as for --until (default: now)",
                required=False,
                default=0,
                label="Comes in at",
                placeholder="now",
            ),
            OrderField(
                "every",
                FieldKind.SPAN,
                "submit one like it at this interval, as ID-1, ID-2 and so on: 90s, 10m, "
                "2h, 1d; this begins at --at, and ends when ID is cancelled or late",
                required=False,
                default=0,
                label="And again every",
                placeholder="10m",
            ),
        ),
        lambda transition, id, data, replace, **more: log_entries.make_submit(
            transition, id, data, replaces=replace, **more
        ),
        example="order --data task.json --id o12",
        note="If it is uncertain whether the team has the task (no answer in time), submit it "
        "again with the same --id: it counts only once. Exit codes: 0 the team has the task, 1 it "
        "does not, or no team was found, 2 the task or the usage is wrong.",
        noun="task",
        word="known",
        like='{"transition": "order", "id": "o1", "data": {"pose": [1, 2]}, "priority": 5}',
        form=Form(
            "entrance",
            "Submit a task …",
            "A task comes in by this transition, with an id and data",
            "Submit {transition}",
            title="Submit a task by “{transition}”",
            text="Of several tasks with one id, the first counts. Actions read the data as "
            "task.NAME.",
            confirm="Submit",
            style="primary",
        ),
    ),
    "tasks": OrderKind(
        "show the tasks that a team has, and how the last ones ended",
        answer=lambda worker: worker.tasks(),
        asks=Asks.ALWAYS,
        example="",
    ),
    "cancel": OrderKind(
        "cancel a task: no robot begins it, or continues it",
        (TASK_FIELD,),
        lambda id: log_entries.CancelTask(log_entries.task_id(id)),
        example="o12",
        noun="task",
        note="The action of a robot that has the task is cancelled, and the plan says what the "
        "robot does then (tasks.on_cancel).",
        form=Form(
            "task",
            "Cancel",
            "No robot will do it. The action of a robot that has it is cancelled",
            "Cancel task {id}",
            title="Cancel task {id}?",
            text="If a robot has it, its action is cancelled, and the plan says where it goes.",
            confirm="Cancel the task",
            style="danger",
        ),
    ),
    "give_back": OrderKind(
        "have the robot that has a task give it back to its queue",
        (TASK_FIELD,),
        lambda id: log_entries.GiveBack(log_entries.task_id(id)),
        example="o12",
        noun="task",
        note="The plan says which queue it is (on_evict, for the place of the robot), and what the "
        "robot does then (tasks.on_cancel).",
        form=Form(
            "task",
            "Give back",
            "The robot that has it gives it back to its queue",
            "Give task {id} back",
            title="Give task {id} back to its queue?",
            text="The action of its robot is cancelled, and the plan says where the robot goes.",
            confirm="Give it back",
            style="danger",
        ),
    ),
    "prioritise": OrderKind(
        "put a task before others, or behind them",
        (
            TASK_FIELD,
            OrderField(
                "priority",
                FieldKind.NUMBER,
                "a whole number; tasks begin with 0",
                label="Priority",
                placeholder="0",
            ),
        ),
        lambda id, priority: log_entries.make_prioritise(id, priority),
        example="o12 5",
        noun="task",
        like='{"id": "o12", "priority": 5}',
        form=Form(
            "task",
            "Priority …",
            "Put it before others, or behind them",
            "Prioritise task {id}",
            title="Priority of task {id}",
            text="Tasks with a higher priority come before others where they wait.",
            confirm="Set the priority",
            style="primary",
        ),
    ),
    "leave": OrderKind(
        "make a robot leave the team, with its token",
        (ROBOT_FIELD,),
        log_entries.Leave,
        example="robot_2",
        form=Form(
            "more",
            "Leave the team",
            "It leaves the team voluntarily and takes its token along.",
            "Make {robot} leave",
        ),
    ),
    "stop": OrderKind(
        "end the run of a team",
        (
            OrderField(
                "reason",
                FieldKind.TEXT,
                "why, for the log",
                required=False,
                default=lambda source: "stopped on the page" if source == PAGE else "",
                label="Reason, for the log",
                placeholder="stopped on the page",
            ),
        ),
        lambda reason: log_entries.Stop(reason or log_entries.Stop().reason),
        example="",
        form=Form(
            "header",
            says="Stop {run}",
            title="Stop the run “{run}”?",
            text="The run ends for the whole team: {team}. Running actions are cancelled. This "
            "cannot be undone.",
            confirm="Stop the run",
            style="danger primary",
        ),
    ),
    "stage": OrderKind(
        "propose another plan to the team",
        (
            OrderField("plan", FieldKind.OBJECT),
            OrderField("map", FieldKind.OBJECT, required=False, default={}),
            OrderField("folder", FieldKind.TEXT, required=False),
        ),
        _stage,
        noun="plan",
        like='{"plan": {...}, "map": {...}}',
    ),
    "adopt": OrderKind(
        "continue under the plan that is staged",
        (STAGE_FIELD,),
        log_entries.Adopt,
        seconds=ADOPT_TIME,
    ),
    "unstage": OrderKind("give up the plan that is staged", (STAGE_FIELD,), log_entries.Unstage),
    "breakpoints": OrderKind(
        "stop a robot at a place or a transition, for debugging",
        (OrderField("names", FieldKind.NAMES),),
        answer=lambda worker, names: worker.breakpoints(names),
        asks=Asks.WITHOUT_ARGUMENT,
        example="Door",
        form=Form("node"),
    ),
    "plan": OrderKind("the plan that the team adopted", answer=_adopted, asks=Asks.ALWAYS),
}
"""Name, as in the service ``Command`` -> the order."""


def is_question(request: OperatorRequest) -> bool:
    """Whether a request changes nothing."""
    kind = ORDERS.get(request.command)
    return kind is not None and kind.is_question(request.argument)


def is_open(command: str) -> bool:
    """Whether a request of this name changes nothing and is answered to everybody who may watch."""
    return command in ORDERS and ORDERS[command].asks is Asks.ALWAYS


def described() -> Dict[str, Dict[str, Any]]:
    """The orders that the page offers, as JSON: name -> its :class:`Form`, and its ``fields``."""
    return {
        name: {
            **order.form._asdict(),
            "fields": [
                {
                    "name": field.name,
                    "kind": field.kind.value,
                    "label": field.label,
                    "help": field.help,
                    "placeholder": field.placeholder,
                }
                for field in order.fields
            ],
        }
        for name, order in ORDERS.items()
        if order.form is not None
    }
