"""Changes a net in its PNPRO file; see ``xml_update``."""

from __future__ import annotations

from typing import Any, Optional

from gspn_framework_package.formats.format import CannotHoldError
from gspn_framework_package.formats.net_equality import Node
from gspn_framework_package.formats.pnpro import to_bytes, value_text, write_position
from gspn_framework_package.formats.xml_tree import all_of, choose_net, tag
from gspn_framework_package.formats.xml_update import XmlNet, inner_element, xml_updater
from gspn_framework_package.model.net import Arc, Place, Transition


class _PnproNet(XmlNet):
    BENDS = ("point",)

    def find_net(self) -> Any:
        nets = [self.root] if tag(self.root) == "gspn" else all_of(self.root, "gspn")
        return choose_net(nets, self.options.net, None)

    def change(self) -> None:
        if any(place.capacity is not None for place in self.new.places):
            raise CannotHoldError
        super().change()

    def parent_of(self, kind: str) -> Any:
        return inner_element(self.net, "edges" if kind == "arc" else "nodes")

    def set_node(self, element: Any, old: Node, new: Node) -> None:
        if isinstance(new, Place) and isinstance(old, Place):
            if old.tokens != new.tokens:
                element.set("marking", str(new.tokens))
            if old.position != new.position:
                _set_corner(element, new, "place")
            return
        assert isinstance(new, Transition) and isinstance(old, Transition)
        kind = "EXP" if new.timed else "IMM"
        if old.timed != new.timed:
            element.set("type", kind)
        if old.timed != new.timed or old.position != new.position:
            _set_corner(element, new, kind)
        if new.timed:
            if not old.timed or old.rate != new.rate:
                element.set("delay", value_text(new.rate, new.name))
            if not old.timed or old.servers != new.servers:
                element.set("nservers", "Infinite" if new.servers is None else str(new.servers))
            return
        if old.timed or old.weight != new.weight:
            element.set("weight", value_text(new.weight, new.name))
        if old.timed or old.priority != new.priority:
            element.set("priority", str(new.priority))

    def shown(self, element: Any) -> Optional[str]:
        return element.get("name")

    def rename(self, element: Any, old: str, new: str) -> None:
        element.set("name", new)
        for arc, drawn in self.arcs:
            if arc.source == old:
                drawn.set("tail", new)
            if arc.target == old:
                drawn.set("head", new)

    def set_arc(self, element: Any, old: Arc, new: Arc) -> None:
        if old.weight != new.weight:
            key = (
                "multiplicity"
                if element.get("mult") is None and element.get("multiplicity")
                else "mult"
            )
            element.set(key, str(new.weight))
        if old.inhibitor != new.inhibitor:
            key = "kind" if element.get("kind") or not element.get("type") else "type"
            element.set(key, "INHIBITOR" if new.inhibitor else "INPUT")


def _set_corner(element: Any, new: Node, kind: str) -> None:
    if new.position is None:
        for key in ("x", "y"):
            element.attrib.pop(key, None)
        return
    write_position(element, new.position, kind)


update = xml_updater(_PnproNet, to_bytes)
