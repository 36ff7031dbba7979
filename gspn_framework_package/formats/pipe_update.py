"""Changes a net in its PIPE file; see ``xml_update``."""

from __future__ import annotations

from typing import Any, List, Optional

from gspn_framework_package.formats.format import CannotHoldError
from gspn_framework_package.formats.net_equality import Node
from gspn_framework_package.formats.pipe import to_bytes, unused
from gspn_framework_package.formats.xml_tree import all_of, label, number_text
from gspn_framework_package.formats.xml_update import (
    Given,
    XmlNet,
    child_of,
    identifier_of,
    set_arc_kind,
    set_position,
    set_text,
    xml_updater,
)
from gspn_framework_package.model.net import Arc, Place, Transition


class _PipeNet(XmlNet):
    BENDS = ("arcpath",)

    def __init__(self, given: Given) -> None:
        super().__init__(given)
        self._class = self._class_in_use()

    def all(self, kind: str) -> List[Any]:
        return all_of(self.net, kind)

    def set_node(self, element: Any, old: Node, new: Node) -> None:
        if old.position != new.position:
            set_position(element, new, True)
        if isinstance(new, Place) and isinstance(old, Place):
            if old.tokens != new.tokens:
                self._count(element, "initialMarking", new.tokens)
            if old.capacity != new.capacity:
                self._count(element, "capacity", new.capacity or 0, plain=True)
            return
        assert isinstance(new, Transition) and isinstance(old, Transition)
        if new.timed and new.servers not in (None, 1):
            raise CannotHoldError
        timing = old._replace(name=new.name, position=new.position)
        if old.timed != new.timed or (timing != new and child_of(element, "timed") is None):
            set_text(element, "timed", "value", "true" if new.timed else "false")
        value = new.number
        if old.timed != new.timed or value != old.number:
            set_text(element, "rate", "value", number_text(value))
            for specific in all_of(element, "toolspecific"):
                if specific.get("rateDefinition"):
                    specific.set("rateDefinition", number_text(value))
        if new.timed and (not old.timed or old.servers != new.servers):
            infinite = "true" if new.servers is None else "false"
            set_text(element, "infiniteServer", "value", infinite)
        if not new.timed and (old.timed or old.priority != new.priority):
            set_text(element, "priority", "value", str(new.priority))

    def _count(self, element: Any, name: str, count: int, plain: bool = False) -> None:
        """Set a number of tokens, as pairs of classes and numbers if it is written like that."""
        outer = child_of(element, name)
        was = (outer is not None and child_of(outer, "value") is not None) and (
            child_of(outer, "value").text or ""
        ).strip()
        text = str(count)
        parts = [p.strip() for p in was.split(",")] if was else []
        if len(parts) > 1 and len(parts) % 2 == 0:
            used = [i for i in range(0, len(parts), 2) if parts[i + 1] not in ("", "0")]
            where = used[0] if used else 0
            for i in range(0, len(parts), 2):
                parts[i + 1] = str(count) if i == where else "0"
            text = ",".join(parts)
        elif not parts and not plain and self._classes():
            text = "%s,%d" % (self._classes()[0], count)
        set_text(element, name, "value", text)

    def _classes(self) -> List[str]:
        """The classes of tokens that the document declares."""
        found = [*all_of(self.net, "token"), *all_of(self.net, "tokenclass")]
        return [identifier_of(e) for e in found if e.get("id")]

    def shown(self, element: Any) -> Optional[str]:
        return label(element, "name", "value")

    def rename(self, element: Any, old: str, new: str) -> None:
        set_text(element, "name", "value", new)
        identifier = element.get("id")
        if identifier == old and new not in self.used:
            element.set("id", new)
            self.used.add(new)
            for arc in self.all("arc"):
                for end in ("source", "target"):
                    if (arc.get(end) or "").strip() == old:
                        arc.set(end, new)

    def set_arc(self, element: Any, old: Arc, new: Arc) -> None:
        if old.weight != new.weight:
            self._count(element, "inscription", new.weight)
        if old.inhibitor != new.inhibitor:
            set_arc_kind(element, new.inhibitor)

    def fresh(self, element: Any, name: str) -> None:
        element.set("id", unused(name, self.used))
        self._in_class(element, "initialMarking")

    def connect(self, element: Any, arc: Arc) -> None:
        source, target = (identifier_of(self.elements[name]) for name in (arc.source, arc.target))
        element.set("id", unused("%s to %s" % (source, target), self.used))
        element.set("source", source)
        element.set("target", target)
        self._in_class(element, "inscription")

    def _in_class(self, element: Any, name: str) -> None:
        """Write a number of tokens as this document does: of its class, or plain."""
        outer = child_of(element, name)
        if outer is None:
            return
        value = child_of(outer, "value")
        number = value.text.rpartition(",")[2]
        value.text = "%s,%s" % (self._class, number) if self._class else number

    def _class_in_use(self) -> str:
        plain = False
        for element in [*self.all("place"), *self.all("arc")]:
            for name in ("initialMarking", "inscription"):
                outer = child_of(element, name)
                value = child_of(outer, "value") if outer is not None else None
                parts = ((value.text or "") if value is not None else "").split(",")
                for cls, number in zip(parts[::2], parts[1::2]):
                    if number.strip() not in ("", "0"):
                        return cls.strip()
                plain = plain or parts[0].strip().isdigit()
        classes = self._classes()
        return "" if plain else classes[0] if classes else "Default"


update = xml_updater(_PipeNet, to_bytes)
