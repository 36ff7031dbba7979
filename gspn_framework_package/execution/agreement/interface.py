"""The inputs and effects of a replica: the interface between the agreement core and its host.

The core is :class:`~gspn_framework_package.execution.agreement.replica.Replica`::

    replica = Replica(plan, robot, run, log_id, records)  # records: its own log read back, or []
    carry_out(replica.start(now))
    ...
    carry_out(replica.step(some_input, now))              # on one thread, one input after the other

``now`` is a monotonic clock in seconds. ``step`` returns a list of effects, **to be carried out in
order**: in particular, a :class:`Persist` must be written to the file before any later effect
leaves the process. Nothing in the core blocks, sleeps, or reads a clock.

The host of a replica

- gives it a :class:`Tick` at the time of the last :class:`WakeAt` (earlier or additional ticks are
  harmless);
- gives it every protocol message it receives as a :class:`Received`. Loss, duplication, reordering
  and messages that are not for this robot are harmless; messages of its own are ignored;
- carries out :class:`Send`: in full synchronisation it broadcasts the message (``to`` names a
  robot, or is "" for everybody; one message to several robots may be sent once). In partial
  synchronisation it broadcasts messages of kind ``hello``; any other message is the request of a
  call, whose reply comes back as another :class:`Received`. A call that fails or times out counts
  as a lost message;
- serves such calls: the request becomes a :class:`Received` with a ``request_id`` chosen by the
  host; the step that takes it returns exactly one :class:`Reply` with that id. An empty reply,
  ``{}``, is not passed back to the caller's replica;
- starts and cancels actions for :class:`StartAction` and :class:`CancelAction`, which always
  concern this robot, and reports each attempt's end once, with :class:`ActionDone` or
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
    TaskEnded,
)
from gspn_framework_package.execution.log_entries import NOBODY, NOTHING, Entry, Giver, Submit
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan

Message = Dict[str, Any]
"""A protocol message as a JSON object (see
:mod:`~gspn_framework_package.execution.agreement.messages`)."""

EVERYBODY = ""
"""``Send.to`` of a broadcast, which also reaches robots that are not in the team (yet)."""

# -- inputs ----------------------------------------------------------------------------------------


class Tick(NamedTuple):
    """Time has passed."""


class Received(NamedTuple):
    """A protocol message arrived; ``request_id`` is "" if the sender expects no reply."""

    message: Message
    request_id: str = ""


class ActionDone(NamedTuple):
    """The action of (incarnation, visit, attempt) succeeded. ``result`` names a transition, or is
    "" (or "None") to let the policy decide; ``data`` is what the action wrote."""

    incarnation: int
    visit: int
    attempt: int
    result: str = ""
    data: Mapping[str, Any] = NOTHING


class AttemptFailed(NamedTuple):
    """An attempt failed."""

    incarnation: int
    visit: int
    attempt: int
    reason: Outcome
    detail: str = ""


class EventObserved(NamedTuple):
    """The source of an event reports a change: its condition ``holds`` or no longer does, or (None)
    an instantaneous event occurred. ``cause`` is the data read from it. Only changes need to be
    passed, and instantaneous events only while :meth:`Replica.watches` is true."""

    transition: str
    holds: Optional[bool]
    cause: Mapping[str, Any] = NOTHING


class TaskCame(NamedTuple):
    """A task reached this robot, and perhaps others as well. The robot keeps it until it is in the
    log."""

    task: Submit


class TimeOfDay(NamedTuple):
    """The time of day, in seconds since 1970, for tasks that come in at a time, or wait no longer
    than until then, and for the clock of a plan. Give it at intervals while there are any."""

    seconds: int


class Order(NamedTuple):
    """An operator's order, given to this robot: ``entry`` is a Retry, Fire, Submit, Leave, Evict,
    SetPlace, Pause, Resume, Stop, StagePlan, Adopt or Unstage. Answered by an :class:`OrderResult`
    of the same ``order_id`` once it is in the log; without a quorum this may never happen, so the
    caller sets its own deadline. For an Evict, incarnation -1 means the present one; for an Adopt
    or Unstage, stage -1 means the present one."""

    order_id: str
    entry: Entry


class OrderGiven(NamedTuple):
    """An operator gave this robot an order of any kind, which is to be recorded in its log. The
    :class:`Order` itself, if there is one, is the next input."""

    command: str
    robot: str
    """The robot that the order concerns; "" for the team or this robot."""
    argument: str
    operator: str
    """The operator; "" if unknown."""
    proof: str
    """How the operator was authenticated; "" if not at all."""


class Examined(NamedTuple):
    """The answer to an :class:`Examine`: why this robot cannot follow the plan staged as number
    ``stage``; "" if it can."""

    stage: int
    why: str = ""


class ForceEvict(NamedTuple):
    """The operator asserts that ``robot`` ("" for every robot that is not heard) is switched off,
    and stays off until it has been evicted.

    If the others are a quorum, they evict it like a silent robot. If not, *all* robots that are not
    asserted to be off have to agree, and everything that only the evicted robots knew is given up.
    Refused if the robot was heard recently; withdrawn if the robot is heard before it is evicted.
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
    TimeOfDay,
    Order,
    OrderGiven,
    Examined,
    ForceEvict,
]

# -- effects ---------------------------------------------------------------------------------------


class Persist(NamedTuple):
    """Append this record to the robot's log before anything after it in the list is carried out
    (see :mod:`~gspn_framework_package.execution.event_log`).

    ``durable``: if the plan's ``fsync`` is on, the log must be synced to the disk up to this record
    before any later effect is carried out. One sync is enough for several consecutive records. A
    record without a durable record after it may be lost in a power loss; the replica tolerates
    that. ``synced``: sync even if the plan's ``fsync`` is off.
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

    ``publish``: this robot decided it, and its host publishes it. ``private``: a
    local transition of this robot (partial synchronisation). Its position is (robot, visit), slot
    and index have no meaning, and ``firing.marking`` is the marking that this robot knows. It is
    reported again with its position in the agreed log (``private`` and ``publish`` false) once it
    is there. ``hash`` is the value of the hash chain after the slot of the firing, ``plan`` the
    plan in force at the time.
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
    """The folder of its functions; "" for the folder at the start."""


class PlanChanged(NamedTuple):
    """From here on the team follows ``plan``, which applies to all later goals. A running action
    continues as it was started. ``mapping`` maps names in the previous plan to names in this
    one."""

    plan: Plan
    folder: str
    mapping: Mapping[str, str] = NOTHING


class OrderResult(NamedTuple):
    """The outcome of an :class:`Order` or :class:`ForceEvict`."""

    order_id: str
    ok: bool
    text: str


class StatusChanged(NamedTuple):
    """The answer of :meth:`Replica.status` has changed in a way that people should know; ``text``
    is a line for the robot's screen output."""

    text: str


class Halted(NamedTuple):
    """This replica must stop (another plan, a diverging log, another process of the same name, or a
    successor). It no longer takes part, and its actions have been cancelled. The host exits with
    code 1 and prints ``reason``."""

    reason: str


class WakeAt(NamedTuple):
    """Give a :class:`Tick` at that time at the latest (on the clock of ``now``); replaces the
    previous request."""

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
    TaskEnded,
    Examine,
    PlanChanged,
    OrderResult,
    StatusChanged,
    Halted,
    WakeAt,
]
