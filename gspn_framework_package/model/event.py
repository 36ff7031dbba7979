"""Events, which make transitions fire from outside, and tasks, which enter a team through such
transitions.

An *event transition* is an exponential transition with a source. If it leaves an action place, its
event *interrupts* the action of a robot there. If it touches resource places only, it belongs to
the environment: each message is a *task*, which fires it once, or it has hours of the day, and
fires in them.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, Mapping, NamedTuple, Optional, Tuple

POLL_EVERY = 0.2
"""Seconds between two calls of an event's function."""

_HOUR = 3_600_000
"""Milliseconds of an hour, in which hours of the day are compared."""

_DAY = 24 * _HOUR


class SourceKind(NamedTuple):
    """A kind of source that another package adds to those of :class:`EventSource`. A plan file
    gives, under the kind's name, an object with its settings.

    :ivar name: its name.
    :ivar form: the JSON Schema of the object.
    :ivar function: the event function that watches it, on ROS and without (see
        :mod:`gspn_framework_package.execution.event_functions`); it takes the settings.
    :ivar after: makes, from the settings, the seconds in the place after which the event comes in
        the analysis and the simulation. None: it comes at the rate of its transition. A function
        of a module, as is ``function``, so that other processes can be given it.
    """

    name: str
    form: Mapping[str, Any]
    function: Callable[..., Any]
    after: Optional[Callable[..., float]] = None


SOURCE_KINDS: Dict[str, SourceKind] = {}
"""The kinds of sources that other packages have added, by name."""


class EventSource(NamedTuple):
    """The source of an event, and its effect.

    Sources: a ROS ``topic`` with messages of ``type`` (relative to the robot's namespace), a Python
    ``function`` of the plan's folder (with ``settings``, called every ``every`` seconds unless it
    emits its events itself), time: ``after`` seconds in the place, or what another package has
    added (``kind``, with ``settings``). With both a topic and a
    function, the topic is used on ROS and the function without it. A transition of the environment
    needs no source: ``gspn submit`` fires it in any case. But one with hours of the day
    (UTC), ``from_hour`` to ``to_hour``, lets no tasks in: it fires when it is enabled in them.

    ``when`` is a condition on the message (see :mod:`.message_condition`): the event holds while it
    is true. Without one, every message is an event. An event that already holds when the robot
    enters the place fires at once, unless ``edge`` is set: then only a change from false to true
    counts.

    If the transition is not enabled when the event occurs, nothing happens, unless ``hold`` is set:
    then it fires as soon as it can, while the robot is in that visit. After an interrupt with
    ``resume``, the robot's next visit to the place learns which visit it continues.

    For tasks: ``id`` names the field of the message that identifies it (default: ``id``, else the
    sequence number in its header); ``json`` names a string field whose text is the task's data as
    JSON (default: the data are the fields of the message).
    """

    topic: str = ""
    type: str = ""
    when: str = ""
    function: str = ""
    settings: Mapping[str, Any] = {}
    every: float = POLL_EVERY
    after: Optional[float] = None
    edge: bool = False
    hold: bool = False
    resume: bool = False
    id: str = ""
    json: str = ""
    kind: Optional[SourceKind] = None
    from_hour: Optional[float] = None
    to_hour: Optional[float] = None

    def seconds_to_hours(self, seconds: float) -> float:
        """Seconds from a time until its hours begin; 0: that time is within them.

        :param seconds: the time, since 1970 (s).
        """
        assert self.from_hour is not None and self.to_hour is not None
        begins, ends = round(_HOUR * self.from_hour), round(_HOUR * self.to_hour)
        since = (round(1_000 * seconds) - begins) % _DAY
        return 0.0 if since < (ends - begins) % _DAY else (_DAY - since) / 1_000

    @property
    def label(self) -> str:
        """The source of the event for people."""
        if self.kind is not None:
            return self.kind.name
        if self.after is not None:
            return "after %g s" % self.after
        if self.from_hour is not None and self.to_hour is not None:
            return "from %g to %g h" % (self.from_hour, self.to_hour)
        if self.topic:
            return "topic %s%s" % (self.topic, ": " + self.when if self.when else "")
        return self.function or "gspn submit"

    def asks_function(self, topics: bool) -> bool:
        """Whether the function is used as the source.

        :param topics: whether topics can be subscribed to.
        """
        return self.kind is not None or bool(self.function) and not (topics and self.topic)

    @property
    def is_watched(self) -> bool:
        """Whether anything watches for the event, other than the time in the place."""
        return bool(self.topic or self.function or self.kind)

    @property
    def comes_after(self) -> Optional[float]:
        """The seconds in the place after which the event comes, in the analysis and the
        simulation; None: it comes at the rate of its transition."""
        if self.kind is None or self.kind.after is None:
            return self.after
        return self.kind.after(**self.settings)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> EventSource:
        """The source in a JSON object that fits the schema."""
        kind = next((SOURCE_KINDS[key] for key in data if key in SOURCE_KINDS), None)
        if kind is None:
            return cls(**data)
        own = {key: value for key, value in data.items() if key != kind.name}
        return cls(**own, settings=data[kind.name], kind=kind)

    def to_json(self) -> Dict[str, Any]:
        """The source as a JSON object, without default values."""
        default = EventSource()
        given = self._asdict()
        if self.kind is not None:
            given.update({self.kind.name: given.pop("settings"), "kind": None})
        return {k: v for k, v in given.items() if v != getattr(default, k, None)}


BY_ARRIVAL, BY_PRIORITY, BY_DEADLINE = "arrival", "priority", "deadline"
QUEUE_ORDERS = (BY_ARRIVAL, BY_PRIORITY, BY_DEADLINE)
"""The orders in which the tasks of a queue are taken: as they came; those of a higher priority
before others; those that will be late sooner before others, and of these those of a higher
priority. Among equals, the first that came is the first to be taken."""


class Tasks(NamedTuple):
    """The tasks of a plan: ``queues`` are resource places whose tokens are tasks; a robot that
    takes a token carries the task. The transitions ``done`` complete the task of a robot.

    ``order``: queue -> one of :data:`QUEUE_ORDERS`; a queue that is not there is taken
    :data:`BY_PRIORITY`.

    ``on_cancel``: action place -> the transition for which a robot there asks when its task is
    cancelled; None: it continues with its action, without the task. Elsewhere its action is
    cancelled and it waits for the operator.
    """

    queues: Tuple[str, ...] = ()
    done: Tuple[str, ...] = ()
    on_cancel: Mapping[str, Optional[str]] = {}
    order: Mapping[str, str] = {}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Tasks:
        """The object of a plan file that fits the schema."""
        return cls(
            tuple(data.get("queues", ())),
            tuple(data.get("done", ())),
            dict(data.get("on_cancel", {})),
            dict(data.get("order", {})),
        )

    def to_json(self) -> Dict[str, Any]:
        """The JSON object of a plan file."""
        found: Dict[str, Any] = {"queues": list(self.queues), "done": list(self.done)}
        if self.on_cancel:
            found["on_cancel"] = dict(self.on_cancel)
        if self.order:
            found["order"] = dict(self.order)
        return found
