"""The interface of a replica's host for callers on other threads."""

from __future__ import annotations

from typing import Any, Callable, Dict, List, NamedTuple, Optional, TypeVar

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement.interface import Message
from gspn_framework_package.execution.team_state import StagedPlan
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.team.carrier import Operator, OperatorRequest


class View(NamedTuple):
    """What a host knows about its robot and the team, including its own local transitions."""

    place: str
    """Name of the robot's place; "" if it has none."""
    robot_state: str
    incarnation: int
    visit: int
    marking: Marking
    net: Net
    slot: int
    hash: str


AnswerT = TypeVar("AnswerT")


class Worker:
    """What callers on other threads use of a host. ``enqueue`` and ``ask`` may be called from
    any thread, the other methods only on the worker thread."""

    robot: str
    run: str

    def enqueue(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Have the worker thread call ``function(*arguments)`` soon."""
        raise NotImplementedError

    def ask(self, question: Callable[[], AnswerT], timeout: float) -> AnswerT:
        """Call ``question()`` on the worker thread and return its result.

        :param timeout: seconds to wait for it.
        :raises queue.Empty: the call did not return in time.
        """
        raise NotImplementedError

    def view(self) -> View:
        """The robot and the team as this host knows them; call this on the worker thread."""
        raise NotImplementedError

    def status(self, data: str = "") -> Dict[str, Any]:
        """The host's status, for people and programs, as a JSON object; call this on the worker
        thread.

        :param data: ``data``: with the data, tasks and held events of the team; ``brief``: with
            these as short texts; "": without.
        """
        raise NotImplementedError

    def adopted(self) -> Optional[StagedPlan]:
        """The plan that the team adopted; None if it still follows its first plan. Call this on the
        worker thread."""
        raise NotImplementedError

    def breakpoints(self, names: Optional[List[str]]) -> str:
        """The breakpoints of the host's robot, for people; call this on the worker thread.

        :param names: the places and transitions to set, None to leave them as they are.
        :raises GspnError: they are not of the plan, or cannot be kept in the file.
        """
        raise NotImplementedError

    def request(self, message: Message, answer: Callable[[Message], None]) -> None:
        """Pass a peer's protocol message to the replica; call this on the worker thread.

        :param answer: receives the reply, once.
        """
        raise NotImplementedError

    def note_order(self, request: OperatorRequest, operator: Operator) -> None:
        """Record in the log who gave an order; call this on the worker thread, before the order."""
        raise NotImplementedError

    def order(self, entry: log_entries.Ordered, answer: Callable[[Any], None]) -> None:
        """Give an operator's order to the replica; call this on the worker thread.

        :param answer: receives the ``OrderResult``.
        """
        raise NotImplementedError
