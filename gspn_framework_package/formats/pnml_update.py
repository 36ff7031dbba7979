"""Changes a net in its PNML file; see ``xml_update``."""

from __future__ import annotations

from typing import Any, Dict, Optional

from gspn_framework_package.formats.format import CannotHoldError
from gspn_framework_package.formats.net_equality import Node, meaning
from gspn_framework_package.formats.pnml import to_bytes
from gspn_framework_package.formats.pnml_family import OWN, STOCHASTIC
from gspn_framework_package.formats.xml_tree import all_of, arc_kind, label, number_text, tag
from gspn_framework_package.formats.xml_update import (
    Given,
    XmlNet,
    append_element,
    element_like,
    identifier_of,
    remove_element,
    set_arc_kind,
    set_position,
    set_text,
    xml_updater,
)
from gspn_framework_package.model.net import Arc, Place, Transition


class _PnmlNet(XmlNet):
    def __init__(self, given: Given) -> None:
        super().__init__(given)
        self._counted: Dict[str, int] = {}  # letter -> the number to try next

    def counts(self, element: Any) -> bool:
        return tag(element.getparent()) in ("net", "page")

    def arcs_of(self, element: Any) -> int:
        return 2 if arc_kind(element) == "test" else 1

    def parent_of(self, kind: str) -> Any:
        nodes = [*self.all("place"), *self.all("transition")]
        if nodes:
            return nodes[0].getparent()
        pages = all_of(self.net, "page")
        return pages[0] if pages else self.net

    def set_node(self, element: Any, old: Node, new: Node) -> None:
        if old.position != new.position:
            set_position(element, new, False)
        if isinstance(new, Place) and isinstance(old, Place):
            if old.tokens != new.tokens:
                set_text(element, "initialMarking", "text", str(new.tokens))
            if old.capacity != new.capacity:
                capacity = None if new.capacity is None else str(new.capacity)
                _set_property(element, OWN, "1.0", "capacity", capacity)
            return
        assert isinstance(new, Transition) and isinstance(old, Transition)
        if meaning(old)[1:] == meaning(new)[1:]:
            return
        if old.function is not None or new.function is not None:
            raise CannotHoldError
        if new.timed:
            self._set_timed(element, old, new)
        else:
            self._set_immediate(element, old, new)
        for delay in all_of(element, "delay"):
            if old.timed != new.timed:
                remove_element(delay)

    def _set_timed(self, element: Any, old: Transition, new: Transition) -> None:
        stochastic = (STOCHASTIC, "0.2")
        if not old.timed or old.rate != new.rate:
            _set_property(element, *stochastic, "distributionType", "EXPONENTIAL")
            value = new.number
            if _property(element, OWN, "parameter") != "rate":
                if old.timed or self._prom():
                    value = self._parameter(new.number)
                else:
                    _set_property(element, OWN, "1.0", "parameter", "rate")
            _set_property(element, *stochastic, "distributionParameters", number_text(value))
        default = self.options.servers(1)
        if new.servers != (old.servers if old.timed else default):
            servers = "infinite" if new.servers is None else str(new.servers)
            _set_property(element, OWN, "1.0", "servers", servers)

    def _set_immediate(self, element: Any, old: Transition, new: Transition) -> None:
        stochastic = (STOCHASTIC, "0.2")
        if old.timed:
            _set_property(element, *stochastic, "distributionType", "IMMEDIATE")
        if old.timed or old.weight != new.weight:
            _set_property(element, *stochastic, "weight", number_text(new.number))
        if old.timed or old.priority != new.priority:
            _set_property(element, *stochastic, "priority", str(new.priority))

    def _prom(self) -> bool:
        return any(
            e.get("tool") == STOCHASTIC and (len(e) or len(e.attrib) > 2)
            for e in all_of(self.net, "toolspecific")
        )

    def _parameter(self, rate: float) -> float:
        """The parameter that the file's tool has for a rate."""
        if not self._prom():
            return rate
        mean = 1.0 / rate
        for value in (mean, float(repr(mean))):
            if 1.0 / value == rate:
                return value
        raise CannotHoldError

    def shown(self, element: Any) -> Optional[str]:
        return label(element, "name", "text")

    def rename(self, element: Any, old: str, new: str) -> None:
        set_text(element, "name", "text", new)

    def set_arc(self, element: Any, old: Arc, new: Arc) -> None:
        if old.weight != new.weight:
            set_text(element, "inscription", "text", str(new.weight))
        if old.inhibitor != new.inhibitor:
            set_arc_kind(element, new.inhibitor)

    def remove_node(self, element: Any) -> None:
        gone = [identifier_of(element)]
        remove_element(element)
        while gone:
            target = gone.pop()
            for kind in ("referencePlace", "referenceTransition"):
                for reference in list(self.net.iter("{*}" + kind)):
                    if reference.get("ref") == target:
                        gone.append(identifier_of(reference))
                        remove_element(reference)

    def fresh(self, element: Any, name: str) -> None:
        element.set("id", self._free("p" if tag(element) == "place" else "t"))

    def connect(self, element: Any, arc: Arc) -> None:
        element.set("id", self._free("a"))
        element.set("source", identifier_of(self.elements[arc.source]))
        element.set("target", identifier_of(self.elements[arc.target]))

    def _free(self, letter: str) -> str:
        number = self._counted.get(letter, 0)
        while "%s%d" % (letter, number) in self.used:
            number += 1
        self._counted[letter] = number + 1
        return "%s%d" % (letter, number)


def _property(element: Any, tool: str, key: str) -> Optional[str]:
    for node in all_of(element, "toolspecific"):
        if node.get("tool") == tool:
            for part in all_of(node, "property"):
                if part.get("key") == key:
                    return (part.text or "").strip()
            if node.get(key) is not None:
                return str(node.get(key))
    return None


def _set_property(element: Any, tool: str, version: str, key: str, value: Optional[str]) -> None:
    """Set a property in the data of a tool, in its present position; None removes it."""
    nodes = [n for n in all_of(element, "toolspecific") if n.get("tool") == tool]
    for node in reversed(nodes):
        for part in reversed(all_of(node, "property")):
            if part.get("key") == key:
                if value is None:
                    remove_element(part)
                else:
                    part.text = value
                return
        if node.get(key) is not None:
            if value is None:
                del node.attrib[key]
            else:
                node.set(key, value)
            return
    if value is None:
        return
    if nodes:
        node = nodes[-1]
    else:
        node = element_like(element, "toolspecific")
        node.set("tool", tool)
        node.set("version", version)
        append_element(element, node)
    made = element_like(node, "property")
    made.set("key", key)
    made.text = value
    append_element(node, made)


update = xml_updater(_PnmlNet, to_bytes)
