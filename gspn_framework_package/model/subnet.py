"""Subnets: the parts of a plan's net that came from other plans."""

from __future__ import annotations

from typing import Any, Dict, Mapping, NamedTuple, Tuple

SEPARATOR = "."
"""Separator between the name of a subnet and a node's name in the subnet's own plan."""


class Subnet(NamedTuple):
    """A part of a net that replaced a place. Its name is that of the place; the names of its nodes
    begin with it (``dock.Approach``).

    :ivar plan: name of the plan that it came from.
    :ivar entry: the place where robots enter.
    :ivar exit: the place where robots leave. Robots there are still inside, but the surrounding
        plan chooses among the transitions that leave it.
    :ivar places: its places, including those of nested subnets, in the order of the net. Shared
        resource places belong to the surrounding plan.
    :ivar transitions: its transitions, likewise.
    :ivar parent: the enclosing subnet; "" for none.
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
            **{**data, "places": tuple(data["places"]), "transitions": tuple(data["transitions"])}
        )

    def to_json(self) -> Dict[str, Any]:
        """The subnet as a JSON object."""
        data = self._asdict()
        data.update(places=list(self.places), transitions=list(self.transitions))
        return data if self.parent else {k: v for k, v in data.items() if k != "parent"}
