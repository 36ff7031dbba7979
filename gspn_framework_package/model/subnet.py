"""Subnets: the parts of a plan's net that came from plans of their own."""

from __future__ import annotations

from typing import Any, Dict, Mapping, NamedTuple, Tuple

SEPARATOR = "."
"""Stands between the name of a subnet and the name that a node has in the subnet's own plan."""


class Subnet(NamedTuple):
    """A part of a net that replaced a place. Its name is that of the place; the names of its nodes
    begin with it (``dock.Approach``).

    :ivar plan: name of the plan that it was made from.
    :ivar entry: the place where robots enter.
    :ivar exit: the place where robots leave. The robots there are still inside, but the plan around
        the subnet chooses among the transitions that leave it.
    :ivar places: its places, with those of subnets inside it, in the order of the net. Shared
        resource places belong to the plan around it.
    :ivar transitions: its transitions, likewise.
    :ivar parent: the subnet that it is inside of; "" for none.
    """

    plan: str
    entry: str
    exit: str
    places: Tuple[str, ...]
    transitions: Tuple[str, ...]
    parent: str = ""

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Subnet:
        """The subnet in a JSON object that fits the schema."""
        return cls(
            data["plan"],
            data["entry"],
            data["exit"],
            tuple(data["places"]),
            tuple(data["transitions"]),
            data.get("parent", ""),
        )

    def to_json(self) -> Dict[str, Any]:
        """The subnet as a JSON object."""
        data = self._asdict()
        data.update(places=list(self.places), transitions=list(self.transitions))
        return data if self.parent else {k: v for k, v in data.items() if k != "parent"}
