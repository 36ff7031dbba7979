"""The inputs and effects of a replica: the border between the agreement core and the host that
carries its messages.

The core is :class:`~gspn_framework_package.execution.agreement.replica.Replica`::

    replica = Replica(plan, robot, run, log_id, records)  # records: its own log read back, or []
    carry_out(replica.start(now))
    ...
    carry_out(replica.step(some_input, now))              # on one thread, one input after the other

``now`` is a monotonic clock in seconds. ``step`` returns a list of effects, **to be carried out in
order**: above all a :class:`Persist` must be in the file before anything after it leaves the
process. Nothing in the core blocks, sleeps, or looks at a clock.

The host of a replica

- gives it a :class:`Tick` at the time of the last :class:`WakeAt` (earlier or more often does no
  harm);
- gives it every protocol message it receives as a :class:`Received`. Loss, duplication, reordering
  and messages that are not for this robot are harmless; messages of its own are ignored;
- carries out :class:`Send`: in full synchronisation on the one topic (``to`` a name: that robot;
  ``to`` "": everybody; one message to several robots may be published once, to everybody). In
  partial synchronisation a message of kind ``hello`` goes on the topic; any other is the request of
  a service call to that robot, of the service that :data:`SERVICE_OF_MESSAGE` says, whose reply
  comes back as another :class:`Received`. A call that fails or times out is simply a loss;
- serves such calls: the request becomes a :class:`Received` with a ``request_id`` of the host's
  making; the step that takes it returns exactly one :class:`Reply` of that id (its message may be
  empty, ``{}``: nothing to say; do not feed an empty reply back in);
- starts and cancels actions for :class:`StartAction` and :class:`CancelAction`, which are only ever
  for this robot, and reports each attempt's end once, with :class:`ActionDone` or
  :class:`AttemptFailed`. A cancelled action need not be reported.
"""

from __future__ import annotations

from typing import Any, Dict, Mapping, NamedTuple, Optional, Union

from gspn_framework_package.execution.firing import (
    CancelAction,
    Ended,
    Fault,
    Firing,
    StartAction,
)
from gspn_framework_package.execution.log_entries import NOBODY, NOTHING, Entry, Giver, Submit
from gspn_framework_package.model.plan import Plan

Message = Dict[str, Any]
"""A protocol message as a JSON object (see
:mod:`~gspn_framework_package.execution.agreement.messages`)."""

SERVICE_OF_MESSAGE = {
    "prepare": "get_state",
    "pull": "get_state",
    "event": "get_place",
    "accept": "set_place",
    "learn": "set_place",
}
"""Partial synchronisation: which of a robot's services a message is the request of."""

EVERYBODY = ""
"""``Send.to`` of a broadcast: also to those who are not in the team (yet)."""

# -- inputs ----------------------------------------------------------------------------------------


class Tick(NamedTuple):
    """Time has passed."""


class Received(NamedTuple):
    """A protocol message came in, ``request_id`` "" for one that expects no reply of its own."""

    message: Message
    request_id: str = ""


class ActionDone(NamedTuple):
    """The action of (incarnation, visit, attempt) ended well; ``result`` names a transition, or is
    "" (or "None") for "the policy decides". ``data`` is what it wrote."""

    incarnation: int
    visit: int
    attempt: int
    result: str = ""
    data: Mapping[str, Any] = NOTHING


class AttemptFailed(NamedTuple):
    """An attempt did not succeed; ``reason`` is one of
    :data:`~gspn_framework_package.execution.log_entries.FAILURES`."""

    incarnation: int
    visit: int
    attempt: int
    reason: str
    detail: str = ""


class EventObserved(NamedTuple):
    """A source of an event shows something new: its condition ``holds`` or no longer does, or
    (None) an event came that lasts no time. ``cause`` is what was read of it. Only changes need to
    be given, and events that last no time only while :meth:`Replica.watches` says so."""

    transition: str
    holds: Optional[bool]
    cause: Mapping[str, Any] = NOTHING


class TaskCame(NamedTuple):
    """A task reached this robot, and perhaps others as well. It is kept until it is in the log."""

    task: Submit


class Order(NamedTuple):
    """An operator's order, given to this robot: ``entry`` is a Retry, Fire, Submit, Leave, Evict,
    SetPlace, Pause, Resume, Stop, StagePlan, Adopt or Unstage. Answered by an
    :class:`OrderResult` of the same ``order_id`` once it is in the log (which may never happen
    without a quorum: the caller sets its own deadline). For an Evict the incarnation may be -1: the
    present one; for an Adopt or Unstage the stage may be -1: the present one."""

    order_id: str
    entry: Entry


class OrderGiven(NamedTuple):
    """An operator gave this robot an order, of whatever kind: to be kept in its log. The
    :class:`Order` itself, if there is one, comes as the next input."""

    command: str
    robot: str
    """The robot that it concerns; "": the team, or this robot."""
    argument: str
    operator: str
    """Who gave it; "": nobody knows."""
    proof: str
    """What shows that it was that operator; "": he says so."""


class Examined(NamedTuple):
    """The answer to an :class:`Examine`: why this robot cannot follow the plan staged as number
    ``stage``; "" if it can."""

    stage: int
    why: str = ""


class ForceEvict(NamedTuple):
    """The operator asserts that ``robot`` is switched off, and stays off until it has been evicted;
    "": that every robot that is not heard is.

    If the others are a quorum, they evict it as they do a silent one. If not, *all* robots that no
    assertion was made about have to agree, and whatever only the evicted robots knew is given up.
    Refused if the robot was heard recently; withdrawn if it is heard before it was evicted.
    Answered by an :class:`OrderResult`."""

    order_id: str
    robot: str
    by: Giver = NOBODY


Input = Union[
    Tick,
    Received,
    ActionDone,
    AttemptFailed,
    EventObserved,
    TaskCame,
    Order,
    OrderGiven,
    Examined,
    ForceEvict,
]

# -- effects ---------------------------------------------------------------------------------------


class Persist(NamedTuple):
    """Append this record to the robot's log before anything after it in the list is carried out
    (see :mod:`~gspn_framework_package.execution.event_log`).

    ``durable``: if the plan's ``fsync`` is on, the log has to be on the disk up to this record
    before any other effect after it is carried out. For several records in a row, one wait is
    enough. A record without a durable record after it may be lost with the power supply; the
    replica copes with that. ``synced``: the same, whatever the plan says.
    """

    record: Dict[str, Any]
    durable: bool = False
    synced: bool = False


class Send(NamedTuple):
    """Send a message to a robot, or to :data:`EVERYBODY`."""

    to: str
    message: Message


class Reply(NamedTuple):
    """The answer to the :class:`Received` of that ``request_id``."""

    request_id: str
    message: Message


class Fired(NamedTuple):
    """A transition fired, as every replica learns.

    ``publish``: this robot decided it, and publishes it on ``fired_transitions``.
    ``private``: a move that this robot made on its own (partial synchronisation): its position is
    (robot, visit), slot and index say nothing, and ``firing.marking`` is the marking that this
    robot knows. Such a move appears a second time with its position in the agreed log
    (``private`` and ``publish`` false) once it is in there.
    ``hash`` is the value of the hash chain after the slot of the firing, ``plan`` the plan
    under which it happened.
    """

    firing: Firing
    publish: bool
    hash: str
    plan: Plan
    private: bool = False


class Examine(NamedTuple):
    """A plan was staged: find out whether this robot can follow it (its functions load, its actions
    can be bound), and answer with an :class:`Examined` of that ``stage``. Nothing changes yet."""

    stage: int
    plan: Plan
    folder: str
    """Where its functions are; "": where they were at the start."""


class PlanChanged(NamedTuple):
    """From here on the team follows ``plan``: later goals are bound as it says. What runs goes on
    as it was started. ``mapping`` says how the names of the plan before read in it."""

    plan: Plan
    folder: str
    mapping: Mapping[str, str] = NOTHING


class OrderResult(NamedTuple):
    """The outcome of an :class:`Order` or :class:`ForceEvict`."""

    order_id: str
    ok: bool
    text: str


class StatusChanged(NamedTuple):
    """The answer of :meth:`Replica.status` has changed in a way that people should hear of;
    ``text`` is one line for the robot's own log on the screen."""

    text: str


class Halted(NamedTuple):
    """This replica must not go on (another plan, a diverging log, another process of the same name,
    a successor): it takes no part any more; its actions have been cancelled. The host ends with
    exit code 1 and prints ``reason``."""

    reason: str


class WakeAt(NamedTuple):
    """Give a :class:`Tick` at that time (of ``now``'s clock) at the latest; replaces the previous
    one."""

    time: float


Effect = Union[
    Persist,
    Send,
    Reply,
    Fired,
    StartAction,
    CancelAction,
    Fault,
    Ended,
    Examine,
    PlanChanged,
    OrderResult,
    StatusChanged,
    Halted,
    WakeAt,
]
