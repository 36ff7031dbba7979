"""What the consensus of a replica needs of the replica."""

from __future__ import annotations

from typing import Any, Collection, Dict, List, Protocol, Sequence

from gspn_framework_package.execution.agreement.messages import Batch, Envelope
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.ledger import Item, Ledger


class Host(Protocol):
    """Knows the log and the members, keeps records, carries messages."""

    name: str
    log_id: str
    ledger: Ledger
    is_small: bool
    """Whether the team is so small that everybody may tell everybody something about each slot."""

    def members(self) -> List[str]:
        """The members whose votes count in the open slot, in the order of the log."""

    def others(self) -> List[str]:
        """The members without us."""

    def may_decide(self, voters: Collection[str]) -> bool:
        """Whether these members may decide the open slot."""

    def may_vote(self) -> bool:
        """Whether we are one of them, and know what we promised before."""

    def is_open(self, message: Envelope) -> bool:
        """Whether a message is about the open slot, on top of the same log; where it is not, the
        host helps the one that is behind."""

    def batch(self, frozen: bool) -> Batch:
        """What should go into the open slot, items as JSON values."""

    def own_items(self) -> List[Item]:
        """What we want in the log ourselves."""

    def add_foreign(self, items: Sequence[Item]) -> None:
        """Keep what another wants in the log."""

    def decided(self, batch: Batch, ballot: Ballot, *, mine: bool) -> None:
        """The batch is chosen in the open slot; ``mine``: by our own attempt."""

    def persist(self, record: Dict[str, Any], *, durable: bool = False) -> None:
        """Write a record before anything else leaves the process; see
        :class:`~gspn_framework_package.execution.agreement.interface.Persist`."""

    def send_all(self, to: List[str], body: Any) -> None:
        """Send a message to each of these."""

    def answer(self, to: Envelope, body: Any) -> None:
        """Answer a message."""
