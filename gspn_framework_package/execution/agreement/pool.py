"""What waits to get into the log: a robot's own facts, and those that others told it."""

from __future__ import annotations

from typing import Callable, Dict, Iterable, List, NamedTuple, Optional, Sequence

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.ledger import Item, Origin

CONTROLS = (log.Pause, log.Resume, log.SetPlace, log.Stop)
"""Orders that private moves must not pass: partial synchronisation decides them while every robot
holds still."""

IsNews = Callable[[Origin], bool]


class Own(NamedTuple):
    """A fact of this robot. ``order_id``: whom to tell. ``suspect``: the robot that an Evict for
    its silence is about."""

    item: Item
    order_id: str = ""
    suspect: str = ""


class Pool:
    """The items on their way. Those of one origin stay in the order of their numbers."""

    def __init__(self) -> None:
        self.own: List[Own] = []
        self._foreign: Dict[str, Dict[Origin, Item]] = {}

    def add_foreign(self, items: Iterable[Item], is_news: IsNews) -> None:
        """Keep what another robot wants in the log."""
        for item in items:
            if is_news(item.origin):
                self._foreign.setdefault(item.origin.robot, {})[item.origin] = item

    def forget(self, robot: str) -> None:
        """Forget what was told of a robot."""
        self._foreign.pop(robot, None)

    def prune(self, is_news: IsNews) -> List[Own]:
        """Forget what is in the log; the own facts that are."""
        for robot in list(self._foreign):
            kept = {o: i for o, i in self._foreign[robot].items() if is_news(o)}
            if kept:
                self._foreign[robot] = kept
            else:
                del self._foreign[robot]
        gone = [own for own in self.own if not is_news(own.item.origin)]
        if gone:
            self.own = [own for own in self.own if is_news(own.item.origin)]
        return gone

    def withdraw_suspicion(self, robots: Iterable[str]) -> None:
        """Take back the Evicts for silence of robots that were heard again."""
        heard = set(robots)
        self.own = [own for own in self.own if own.suspect not in heard or not own.suspect]

    def own_items(self) -> List[Item]:
        """The own facts."""
        return [own.item for own in self.own]

    def origins(self) -> List[str]:
        """The robots that others told about."""
        return list(self._foreign)

    def batch(self, order: Sequence[str], *, frozen: bool, most: Optional[int] = None) -> List[Item]:
        """What goes into the next slot: of each robot, in the given order (others after those),
        first its leading private moves, then the rest; the first ``most`` of them. Not ``frozen``:
        without the orders that need it, and what comes after them.
        """
        items: Dict[str, List[Item]] = {}
        for own in self.own:
            items.setdefault(own.item.origin.robot, []).append(own.item)
        for robot, foreign in self._foreign.items():
            known = items.setdefault(robot, [])
            held = {i.origin for i in known}
            known += [i for o, i in foreign.items() if o not in held]
        first: List[Item] = []
        rest: List[Item] = []
        for robot in sorted(items, key=lambda r: (_rank(order, r), r)):
            leading = True
            for item in sorted(items[robot], key=lambda i: i.origin):
                if not frozen and isinstance(item.entry, CONTROLS):
                    break
                leading = leading and item.private
                (first if leading else rest).append(item)
        return (first + rest)[:most]

    def has_control(self) -> bool:
        """Whether an order waits that needs every robot to hold still."""
        return any(isinstance(own.item.entry, CONTROLS) for own in self.own) or any(
            isinstance(item.entry, CONTROLS) for foreign in self._foreign.values() for item in foreign.values()
        )


def _rank(order: Sequence[str], robot: str) -> int:
    return order.index(robot) if robot in order else len(order)
