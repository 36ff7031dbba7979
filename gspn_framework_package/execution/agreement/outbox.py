"""Collects the effects of a step in order: records, messages, answers, announcements for people.

Owns ``records`` and ``durable``, the length of our own log. Calls no other part; all parts add
their effects here, and :class:`~gspn_framework_package.execution.agreement.replica.Replica` takes
them out.
"""

from __future__ import annotations

from typing import Any, List, Sequence

from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.config import Config
from gspn_framework_package.execution.agreement.messages import Envelope
from gspn_framework_package.execution.agreement.state import ReplicaState
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.firing import Fault


class Outbox:
    """Collects the effects of a step."""

    def __init__(self, config: Config, state: ReplicaState) -> None:
        self.config = config
        self.state = state
        self._effects: List[interface.Effect] = []
        self._request = ""

    # -- begin and end of a step -------------------------------------------------------------------

    def begin(self, request_id: str) -> None:
        """Begin a step that takes a message; ``request_id`` as in
        :class:`~gspn_framework_package.execution.agreement.interface.Received`."""
        self._request = request_id

    def end(self) -> None:
        """End the step: a call that was not answered gets an empty reply."""
        if self._request:
            self.put(interface.Reply(self._request, {}))
            self._request = ""

    def flush(self) -> List[interface.Effect]:
        """Take out the effects so far."""
        effects, self._effects = self._effects, []
        return effects

    @property
    def owes_reply(self) -> bool:
        """Whether the message being handled is a call that was not answered yet."""
        return bool(self._request)

    # -- effects -----------------------------------------------------------------------------------

    def put(self, *effects: interface.Effect) -> None:
        """Add effects, to be carried out after all earlier ones."""
        self._effects += effects

    def persist(self, record: Record, *, durable: bool = False, synced: bool = False) -> None:
        """Add a record, to be written before any later effect leaves the process; see
        :class:`~gspn_framework_package.execution.agreement.interface.Persist`."""
        self.state.records += 1
        if durable:
            self.state.durable = self.state.records
        self.put(interface.Persist(record, durable, synced))

    def send_all(self, to: Sequence[str], body: Any) -> None:
        """Send a message to each of these robots."""
        if to:
            signed = self.signed(body)
            self.put(*(interface.Send(robot, signed) for robot in to))

    def broadcast(self, body: Any) -> None:
        """Send a message to everybody, whether in the team or not."""
        self.put(interface.Send(interface.EVERYBODY, self.signed(body)))

    def answer(self, to: Envelope, body: Any) -> None:
        """Answer a message, by a reply if it was a call."""
        if self._request:
            self.put(interface.Reply(self._request, self.signed(body)))
            self._request = ""
        else:
            self.send_all([to.sender], body)

    def fault(self, message: str) -> None:
        """Announce a fault of this robot."""
        self.put(Fault(self.config.name, message))

    def order_result(self, order_id: str, ok: bool, text: str) -> None:
        """Report the outcome of an order to the operator who gave it."""
        self.put(interface.OrderResult(order_id, ok, text))

    def signed(self, body: Any) -> interface.Message:
        """A message with the envelope that describes its sender."""
        state = self.state
        return Envelope(
            self.config.name,
            self.config.tag,
            state.log_id,
            state.incarnation,
            state.durable,
            state.ledger.length,
            state.ledger.hash,
            body,
            state.torn,
        ).to_json()
