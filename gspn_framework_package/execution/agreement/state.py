"""The complete state of a replica: :class:`ReplicaState`.

Each field has one owner, the only part that writes it; every part may read all fields. A test
searches the source of the parts for assignments by any other part. This module owns nothing itself
and calls nothing.
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
    log_entries.CancelTask,
    log_entries.GiveBack,
)
"""Orders that local transitions must not pass: partial synchronisation decides them while all
robots hold still."""


def is_control(entry: log_entries.Entry) -> bool:
    """Whether local transitions must not pass this entry: an order of :data:`CONTROLS`, or a task
    that replaces another one, whose robot is then sent elsewhere."""
    return isinstance(entry, CONTROLS) or (
        isinstance(entry, log_entries.Submit) and bool(entry.replaces)
    )


class Proposal(NamedTuple):
    """An entry that this robot wants in the log. ``order_id``: the order to answer. ``suspect``:
    the robot that the entry evicts for silence, if it does."""

    item: Item
    order_id: str = ""
    suspect: str = ""


class Waiting:
    """Proposals of one robot, in the order of their origins. There may be many local transitions,
    so operations on other proposals do not iterate over them."""

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
        """The origins of the proposals."""
        return self._all.keys()

    @property
    def asking(self) -> Collection[Proposal]:
        """The proposals that are not local transitions."""
        return self._asking.values()

    @property
    def local(self) -> int:
        """Number of local transitions."""
        return len(self._all) - len(self._asking)

    def append(self, proposal: Proposal) -> None:
        """Add a proposal, replacing any with the same origin."""
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
        """Remove a proposal."""
        del self._all[origin]
        self._asking.pop(origin, None)

    def pop_while(self, gone: Callable[[Origin], bool]) -> List[Proposal]:
        """Remove and return the first proposals, as long as they are ``gone``."""
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
    """Whether all robots hold their local transitions until the slot is decided."""
    sent: float
    """When the attempt was last sent (s)."""
    began: float
    """When this phase began (s)."""
    patient: bool = False
    """Whether to wait longer before sending again, to see whether the network is slow."""
    tries: int = 0
    """Number of retransmissions."""
    promises: Dict[str, Optional[Tuple[Ballot, Batch]]] = field(default_factory=dict)
    """The robots that promised, and what they had accepted."""
    answered: Set[str] = field(default_factory=set)
    """The robots that promised, and those without a vote that reported what they know."""
    strangers: Set[str] = field(default_factory=set)
    """Members for which a process answered that lacks their memory."""
    all_told: bool = True
    """Whether no robot had more local transitions than one answer holds."""
    torn: Torn = field(default_factory=dict)
    """If not empty, the attempt needs the votes of all members, and those of these robots count;
    otherwise it needs a quorum."""
    batch: Optional[Batch] = None
    """The batch; None in the first phase."""


class Goal(NamedTuple):
    """An attempt at the action of a visit; a later one is larger."""

    incarnation: int
    visit: int
    attempt: int


class Position(NamedTuple):
    """The robot's position: ``place`` is an index, ``doing`` whether its action should run."""

    place: int
    incarnation: int
    visit: int
    attempt: int
    doing: bool

    @property
    def goal(self) -> Goal:
        """The attempt that should run, or has run."""
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
    """The result of the agreed log so far: the state of the team, the hash chain, and whose logs
    count."""
    recent: RecentSlots = field(metadata={"owner": "replication"})
    """The newest slots, for robots that are behind."""
    first_hash: str = _owned("replication", "")
    """Hash of the first slot; "" before we have it. It differs between different first teams."""
    asked_until: Tuple[int, float] = _owned("replication", (-1, 0.0))
    """The slot from which on we asked for slots, and the time (s) before which we do not ask
    again."""

    # -- our own log file ---------------------------------------------------------

    records: int = _owned("outbox", 0)
    """How many records our log has."""
    durable: int = _owned("outbox", 0)
    """How many of them are safe from a power loss."""

    # -- our identity ------------------------------------------------------------------------------

    log_id: str = _owned("membership", "")
    """Id of our log, which stands for one memory of votes: a replica that forgets its votes takes a
    new id."""
    incarnation: int = _owned("membership", 0)
    """Our incarnation, which increases with every restart, eviction and loss of memory."""
    begin_records: int = _owned("membership", 0)
    """Number of records in our log when this incarnation began."""
    active: bool = _owned("membership", False)
    """Whether we take part: every robot knows us as fresh, or a Join admitted us."""
    joining: bool = _owned("membership", False)
    """Whether we are not in the first team, or it started long ago, so that we get the log and then
    join."""
    amnesic: bool = _owned("membership", False)
    """Whether we may have forgotten votes in this run, so that we have no vote until the next
    Join."""
    damage: str = _owned("membership", "")
    """What was damaged in our log, until we are readmitted; "" for nothing."""
    torn: Tuple[str, ...] = _owned("membership", ())
    """After a power loss, the ids of the logs without their ends that ours continues; () once we
    are readmitted."""
    halted: Optional[str] = _owned("membership")
    """Why this replica no longer takes part; None while it does."""
    leaving: bool = _owned("membership", False)
    """Whether we have left and stay only until the remaining members know."""
    leaving_since: Optional[float] = _owned("membership")
    """When we began to wait for that (s)."""
    fenced: bool = _owned("membership", False)
    """Whether our action was stopped because we lost contact with a quorum for too long."""
    superseded_at: Optional[float] = _owned("membership")
    """When another log was admitted under our name (s)."""
    rival_since: Optional[float] = _owned("membership")
    """When we first heard another process of our name after that (s)."""
    namesake_heard: Optional[float] = _owned("membership")
    """When we, outside the team, last heard a process of our name that is in the team (s)."""
    namesake_answered: float = _owned("membership", -math.inf)
    """When we, in the team, last notified another process of our name immediately (s)."""

    # -- the other robots ------------------------------------------------------------------------

    peers: Peers = _owned("membership", make=Peers)
    """When each robot was heard, and what it reported about itself."""
    off: Dict[str, int] = _owned("membership", make=dict)
    """Robots that an operator asserted to be off -> the incarnation that the assertion covers."""
    astray: Dict[str, int] = _owned("membership", make=dict)
    """Robots whose log differs from ours -> a slot before which it differs."""
    strangers: Set[str] = _owned("membership", make=set)
    """Robots of another plan or first team that were reported already."""
    complaints: Dict[Tuple[str, str], int] = _owned("membership", make=dict)
    """Malformed messages, each kind reported once: (sender, reason) -> count."""
    listen_until: float = _owned("membership", 0.0)
    """Time (s) before which a fresh robot does not take part, since another may know its name; 0
    once it is over."""
    next_hello: float = _owned("membership", 0.0)
    """When the next hello is due (s)."""

    # -- proposals ------------------------------------------------------------

    own_proposals: Waiting = _owned("proposals", make=Waiting)
    """This robot's proposals, in the order of their numbers."""
    others_proposals: Dict[str, Waiting] = _owned("proposals", make=dict)
    """Proposals announced by others, by robot."""
    number: int = _owned("proposals", 0)
    """The number of our newest proposal in this incarnation."""

    offered: Dict[Tuple[str, str], Tuple[log_entries.Submit, float]] = _owned(
        "reactions", make=dict
    )
    """Tasks that reached this robot and are not in the log yet: (transition, id) -> the task, and
    when it arrived (s)."""

    # -- acceptor and proposer of the first open slot ----------------------------------------------

    promised: Ballot = _owned("consensus", Ballot(0, ""))
    """The promised ballot; lower ones are refused."""
    accepted: Optional[Tuple[Ballot, Batch]] = _owned("consensus")
    """The ballot and batch accepted in the open slot."""
    highest: Ballot = _owned("consensus", Ballot(0, ""))
    """The highest ballot seen; its proposer leads."""
    attempt: Optional[BallotAttempt] = _owned("consensus")
    """Our own running attempt."""
    frozen_by: Optional[Ballot] = _owned("consensus")
    """The attempt that freezes local transitions until the open slot is decided."""
    round_trip: float = _owned("consensus", 0.0)
    """Smoothed response time of our attempts (s); 0 before the first answer."""
    slow: float = _owned("consensus", 0.0)
    """Upper bound of the round trip (s) from an answer that may belong to a retransmission; 0 once
    it was measured."""
    attempts: List[BallotAttempt] = _owned("consensus", make=list)
    """Our newest attempts."""
    backoff: int = _owned("consensus", 0)
    """Number of retransmissions since the last answer with a known response time."""
    followers: Optional[Set[str]] = _owned("consensus")
    """The robots whose promises of our ballot still hold; None if we do not lead."""
    votes: Dict[Ballot, Set[str]] = _owned("consensus", make=dict)
    """Known votes in the open slot."""
    by_all: Dict[Ballot, Torn] = _owned("consensus", make=dict)
    """The attempt we accepted in an open slot that needs the votes of all, and the robots whose
    votes count there although their logs lost their ends."""

    # -- when to propose ---------------------------------------------------------------------------

    wait_until: Optional[float] = _owned("proposer")
    """Time before which we do not propose (s)."""
    gathers_until: float = _owned("proposer", 0.0)
    """Time before which we do not propose as leader (s)."""
    decided_at: float = _owned("proposer", -math.inf)
    """When our last successful attempt was chosen (s)."""
    busy: Set[str] = _owned("proposer", make=set)
    """The robots whose proposals it contained; while we decide slot after slot, also those of the
    previous slot."""
    gathers: Set[str] = _owned("proposer", make=set)
    """The robots whose next proposals we gather as leader, and until when."""
    gave_way: bool = _owned("proposer", False)
    """Whether we answered another robot's attempt at the open slot in partial synchronisation."""
    defeats: int = _owned("proposer", 0)
    """How often our attempts at the open slot were beaten."""
    frozen_since: Optional[float] = _owned("proposer")
    """When local transitions began to wait for the open slot (s)."""
    voteless: Set[str] = _owned("proposer", make=set)
    """Robots without a vote that rely on members to propose for them."""
    asked_at: Optional[float] = _owned("proposer")
    """When others were first asked to propose for us (s)."""
    last_sent: Tuple[Any, ...] = _owned("proposer", ())
    """The robot to which we last sent our proposals, which ones, and when to send them again."""

    # -- our robot ---------------------------------------------------------------------------------

    position: Optional[Position] = _owned("local_robot")
    """Our robot's position, which may be ahead of the log by local transitions; None if it is not
    in the team."""
    started: Optional[Goal] = _owned("local_robot")
    """The last goal that was started."""
    running: Optional[Goal] = _owned("local_robot")
    """The running goal, whose end has not been reported."""
    reported: Optional[Goal] = _owned("local_robot")
    """The last goal whose end was reported."""

    # -- a staged plan -----------------------------------------------------------------------------

    examining: Tuple[int, int] = _owned("deployment", (0, 0))
    """The stage that our host is examining, and our incarnation that asked it to."""
    examined: Optional[str] = _owned("deployment")
    """Why we cannot follow it, "" if we can; None until the host has answered."""

    # -- people ------------------------------------------------------------------------------------

    held_orders: List[interface.Order] = _owned("orders", make=list)
    """Orders that arrived while we only listened."""
    reported_status: str = _owned("status", "")
    """The last announced reason for waiting."""
    now: float = _owned("replica", 0.0)
    """The time of the present input (s)."""

    def is_frozen(self) -> bool:
        """Whether local transitions must wait for the open slot."""
        return self.frozen_by is not None

    @property
    def delay(self) -> float:
        """The round trip time to assume (s)."""
        return max(self.round_trip, self.slow)

    def hash_at(self, length: int) -> Optional[str]:
        """The hash of the first ``length`` slots; None if we do not (or no longer) know it."""
        return self.ledger.hash if length == self.ledger.length else self.recent.hash_before(length)

    @property
    def leader(self) -> str:
        """The proposer of the highest ballot seen."""
        return self.highest.robot


OWNERS: Dict[str, str] = {f.name: f.metadata["owner"] for f in fields(ReplicaState)}
"""Field of :class:`ReplicaState` -> the only module that writes it."""
