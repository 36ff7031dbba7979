"""Everything that a replica remembers, in one place: :class:`ReplicaState`.

Each field has one owner, the part that alone writes it; every part may read all of them. A test
reads the source of the parts and finds assignments by anybody else. Owns nothing itself, calls
nothing.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field, fields
from typing import (
    AbstractSet,
    Any,
    Callable,
    Collection,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Set,
    Tuple,
)

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.messages import Batch, Torn
from gspn_framework_package.execution.agreement.peers import Peers
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.agreement.recent_slots import RecentSlots
from gspn_framework_package.execution.ledger import Item, Ledger, Origin

CONTROLS = (
    log_entries.Pause,
    log_entries.Resume,
    log_entries.SetPlace,
    log_entries.Stop,
    log_entries.Adopt,
)
"""Orders that local transitions must not pass: partial synchronisation decides them while every
robot holds still."""


class Proposal(NamedTuple):
    """Something that this robot wants in the log. ``order_id``: whom to answer. ``suspect``: the
    robot that an Evict for its silence is about."""

    item: Item
    order_id: str = ""
    suspect: str = ""


class Waiting:
    """Proposals of one robot, in the order of their origins. Local transitions may be many, so what
    concerns the others alone does not look at them."""

    def __init__(self) -> None:
        self._all: OrderedDict[Origin, Proposal] = OrderedDict()
        self._asking: Dict[Origin, Proposal] = {}

    def __iter__(self) -> Iterator[Proposal]:
        return iter(self._all.values())

    def __len__(self) -> int:
        return len(self._all)

    def __contains__(self, origin: Origin) -> bool:
        return origin in self._all

    @property
    def origins(self) -> AbstractSet[Origin]:
        """Where they come from."""
        return self._all.keys()

    @property
    def asking(self) -> Collection[Proposal]:
        """Those that are no local transitions."""
        return self._asking.values()

    @property
    def local(self) -> int:
        """How many are local transitions."""
        return len(self._all) - len(self._asking)

    def append(self, proposal: Proposal) -> None:
        """Add a proposal; one of the same origin is replaced."""
        origin, known = proposal.item.origin, self._all
        late = bool(known) and origin not in known and origin < next(reversed(known))
        known[origin] = proposal
        self._asking.pop(origin, None)
        if not proposal.item.private:
            self._asking[origin] = proposal
        if late:
            self._all = OrderedDict(sorted(known.items()))
            self._asking = dict(sorted(self._asking.items()))

    def remove(self, origin: Origin) -> None:
        """Take a proposal out."""
        del self._all[origin]
        self._asking.pop(origin, None)

    def pop_while(self, gone: Callable[[Origin], bool]) -> List[Proposal]:
        """Take out the first ones, as long as they are ``gone``; returns them."""
        out = []
        while self._all and gone(next(iter(self._all))):
            origin, proposal = self._all.popitem(last=False)
            self._asking.pop(origin, None)
            out.append(proposal)
        return out


@dataclass
class BallotAttempt:
    """A running attempt of ours to get a batch into ``slot``."""

    slot: int
    ballot: Ballot
    frozen: bool
    """Nobody makes a local transition until the slot is decided."""
    sent: float
    """When it was sent last (s)."""
    began: float
    """When this phase of it did (s)."""
    patient: bool = False
    """It waits longer before it is sent again, to see whether the network is slow."""
    tries: int = 0
    """How often it was sent again."""
    promises: Dict[str, Optional[Tuple[Ballot, Batch]]] = field(default_factory=dict)
    """Who promised, and what was accepted there."""
    answered: Set[str] = field(default_factory=set)
    """Those who promised, and those without a vote who reported what they know."""
    strangers: Set[str] = field(default_factory=set)
    """Members under whose name a process answered that lacks their memory."""
    all_told: bool = True
    """Nobody had more local transitions than one answer holds."""
    torn: Torn = field(default_factory=dict)
    """It needs the word of everybody, and that of these robots counts; empty: of a quorum."""
    batch: Optional[Batch] = None
    """None in the first phase."""


class Goal(NamedTuple):
    """An attempt at the action of a visit; a later one is larger."""

    incarnation: int
    visit: int
    attempt: int


class Position(NamedTuple):
    """Where the robot is: ``place`` an index, ``doing`` whether its action should run."""

    place: int
    incarnation: int
    visit: int
    attempt: int
    doing: bool

    @property
    def goal(self) -> Goal:
        """The attempt that should run, or did."""
        return Goal(self.incarnation, self.visit, self.attempt)


def _owned(owner: str, default: Any = None, *, make: Optional[Callable[[], Any]] = None) -> Any:
    """A field that only the module ``owner`` writes."""
    if make is not None:
        return field(default_factory=make, metadata={"owner": owner})
    return field(default=default, metadata={"owner": owner})


@dataclass
class ReplicaState:
    """The state of one replica."""

    # -- the log so far ---------------------------------------------------------------------------

    ledger: Ledger = field(metadata={"owner": "replication"})
    """The agreed log as far as we have it: the state of the team, the hash chain, whose logs
    count."""
    recent: RecentSlots = field(metadata={"owner": "replication"})
    """The newest slots, for those who are behind."""
    first_hash: str = _owned("replication", "")
    """Hash of the first slot; "" before we have it. Replicas of different first teams differ in
    it."""
    asked_until: Tuple[int, float] = _owned("replication", (-1, 0.0))
    """We asked for slots from this one on, and do not ask again before that time (s)."""

    # -- our own record of it, in the file ---------------------------------------------------------

    records: int = _owned("outbox", 0)
    """How many records our log has."""
    durable: int = _owned("outbox", 0)
    """Up to which of them it outlives the power supply."""

    # -- who we are --------------------------------------------------------------------------------

    log_id: str = _owned("membership", "")
    """Id of our log. Votes of one id are one memory: whoever forgets takes a new one."""
    incarnation: int = _owned("membership", 0)
    """Which of our lives this is; goes up with every restart, eviction and loss of memory."""
    begin_records: int = _owned("membership", 0)
    """How many records our log had when this incarnation began."""
    active: bool = _owned("membership", False)
    """We take part: we are known as fresh by everybody, or were admitted by a Join."""
    joining: bool = _owned("membership", False)
    """We are not in the first team (or it has started long ago): learn the log, then join."""
    amnesic: bool = _owned("membership", False)
    """We may have voted in this run and do not remember it; no vote until the next Join."""
    damage: str = _owned("membership", "")
    """What was damaged in our log, until we were let in; "" for nothing."""
    torn: Tuple[str, ...] = _owned("membership", ())
    """The machine lost power: the ids of the logs, without their ends, that ours goes on from; ()
    once we were let in."""
    halted: Optional[str] = _owned("membership")
    """Why this replica takes no part any more; None while it does."""
    leaving: bool = _owned("membership", False)
    """We have left, and stay until those who go on know."""
    leaving_since: Optional[float] = _owned("membership")
    """When we began to wait for that (s)."""
    fenced: bool = _owned("membership", False)
    """Out of contact to a quorum for so long that our action was stopped."""
    superseded_at: Optional[float] = _owned("membership")
    """When another log was let in under our name (s)."""
    rival_since: Optional[float] = _owned("membership")
    """Since when we have heard another process of our name after that (s)."""
    namesake_heard: Optional[float] = _owned("membership")
    """When we, not in the team, last heard a process of our name that is (s)."""
    namesake_answered: float = _owned("membership", -math.inf)
    """When we, in the team, last let a process of our name know at once that we are (s)."""

    # -- who the others are ------------------------------------------------------------------------

    peers: Peers = _owned("membership", make=Peers)
    """Who was heard when, and what they said of themselves."""
    off: Dict[str, int] = _owned("membership", make=dict)
    """Robots that an operator asserted to be off, with the incarnation that the assertion is
    about."""
    astray: Dict[str, int] = _owned("membership", make=dict)
    """Robots whose log differs from ours, with a slot before which it does."""
    strangers: Set[str] = _owned("membership", make=set)
    """Robots of another plan or first team that were named already."""
    complaints: Dict[Tuple[str, str], int] = _owned("membership", make=dict)
    """Messages that were not understood, and named once: (sender, why) -> how many came."""
    listen_until: float = _owned("membership", 0.0)
    """Before that a fresh robot does not take part, since somebody may know its name (s); 0:
    over."""
    next_hello: float = _owned("membership", 0.0)
    """When the next hello is due (s)."""

    # -- what waits to get into the log ------------------------------------------------------------

    own_proposals: Waiting = _owned("proposals", make=Waiting)
    """What this robot wants in the log, in the order of their numbers."""
    others_proposals: Dict[str, Waiting] = _owned("proposals", make=dict)
    """What others said that they want in the log, by robot."""
    number: int = _owned("proposals", 0)
    """The number of our newest proposal in this incarnation."""

    offered: Dict[Tuple[str, str], Tuple[log_entries.Submit, float]] = _owned(
        "reactions", make=dict
    )
    """Tasks that reached this robot, until they are in the log: (transition, id) -> the task, and
    since when it waits (s)."""

    # -- acceptor and proposer of the first open slot ----------------------------------------------

    promised: Ballot = _owned("consensus", Ballot(0, ""))
    """No ballot below it will be accepted."""
    accepted: Optional[Tuple[Ballot, Batch]] = _owned("consensus")
    """What was accepted in the open slot, and under which ballot."""
    highest: Ballot = _owned("consensus", Ballot(0, ""))
    """The highest ballot that was seen; who proposed under it leads."""
    attempt: Optional[BallotAttempt] = _owned("consensus")
    """Our own running attempt."""
    frozen_by: Optional[Ballot] = _owned("consensus")
    """The attempt for which local transitions wait until the open slot is decided."""
    round_trip: float = _owned("consensus", 0.0)
    """For how long answers to our attempts take (s), smoothed; 0 before the first."""
    slow: float = _owned("consensus", 0.0)
    """The round trip (s) is at most this long, by an answer that may be one to a repetition; 0 once
    it was measured."""
    attempts: List[BallotAttempt] = _owned("consensus", make=list)
    """Our newest attempts."""
    backoff: int = _owned("consensus", 0)
    """How often we repeated ourselves since an answer that we know the time of."""
    followers: Optional[Set[str]] = _owned("consensus")
    """Whose promises of our ballot still hold; None where we do not lead."""
    votes: Dict[Ballot, Set[str]] = _owned("consensus", make=dict)
    """Who accepted what in the open slot, as far as we heard."""
    by_all: Dict[Ballot, Torn] = _owned("consensus", make=dict)
    """What we accepted in the open slot that needs the votes of all, and the robots whose votes
    count there although their logs lost their ends."""

    # -- when to propose ---------------------------------------------------------------------------

    wait_until: Optional[float] = _owned("proposer")
    """Before that we do not propose (s)."""
    gathers_until: float = _owned("proposer", 0.0)
    """Before that we do not propose as leader (s)."""
    decided_at: float = _owned("proposer", -math.inf)
    """When our last attempt was chosen (s)."""
    busy: Set[str] = _owned("proposer", make=set)
    """The robots whose proposals it decided; while we decide slot after slot, with those of the
    slot before."""
    gathers: Set[str] = _owned("proposer", make=set)
    """The robots whose next proposals we gather as leader, until that time."""
    gave_way: bool = _owned("proposer", False)
    """In the open slot of partial synchronisation, to another's attempt."""
    defeats: int = _owned("proposer", 0)
    """How often our attempts at the open slot were beaten."""
    frozen_since: Optional[float] = _owned("proposer")
    """Since when local transitions wait for the open slot (s)."""
    voteless: Set[str] = _owned("proposer", make=set)
    """Robots without a vote that have their proposals made by members."""
    asked_at: Optional[float] = _owned("proposer")
    """Since when others were asked to propose what waits here (s)."""
    last_sent: Tuple[Any, ...] = _owned("proposer", ())
    """Whom we sent our proposals last, which, and when we do it again."""

    # -- our robot ---------------------------------------------------------------------------------

    position: Optional[Position] = _owned("local_robot")
    """Where our robot is, ahead of the log by its local transitions; None: not in the team."""
    started: Optional[Goal] = _owned("local_robot")
    """The last goal that went out."""
    running: Optional[Goal] = _owned("local_robot")
    """The goal whose end has not been reported."""
    reported: Optional[Goal] = _owned("local_robot")
    """The last goal whose end was."""

    # -- a staged plan -----------------------------------------------------------------------------

    examining: Tuple[int, int] = _owned("deployment", (0, 0))
    """The stage that our host looks at, and the incarnation of ours that asked it."""
    examined: Optional[str] = _owned("deployment")
    """Why we cannot follow it, "" if we can; None until the host has answered."""

    # -- people ------------------------------------------------------------------------------------

    held_orders: List[interface.Order] = _owned("orders", make=list)
    """Orders that came while we only listened."""
    reported_status: str = _owned("status", "")
    """What we last reported to people that we wait for."""
    now: float = _owned("replica", 0.0)
    """The time of the input that is being taken (s)."""

    def is_frozen(self) -> bool:
        """Whether local transitions must wait for the open slot."""
        return self.frozen_by is not None

    @property
    def delay(self) -> float:
        """The round trip to reckon with (s)."""
        return max(self.round_trip, self.slow)

    def hash_at(self, length: int) -> Optional[str]:
        """The hash of the first ``length`` slots, None where we do not know (any more)."""
        return self.ledger.hash if length == self.ledger.length else self.recent.hash_before(length)

    @property
    def leader(self) -> str:
        """Who proposed under the highest ballot seen."""
        return self.highest.robot


OWNERS: Dict[str, str] = {f.name: f.metadata["owner"] for f in fields(ReplicaState)}
"""Field of :class:`ReplicaState` -> the module that alone writes it."""
