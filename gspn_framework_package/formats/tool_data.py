"""Reports timing in the ``toolspecific`` data of other tools, which is not read."""

from __future__ import annotations

import re

from lxml import etree

from gspn_framework_package.formats.draft import NetDraft
from gspn_framework_package.formats.pnml_family import OWN, STOCHASTIC
from gspn_framework_package.formats.xml_tree import attributes, tag
from gspn_framework_package.model.expression import shorten

_READ = (OWN, STOCHASTIC)
_PARTS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
_TIMES = frozenset(
    [
        "time",
        "times",
        "delay",
        "delays",
        "duration",
        "interval",
        "clock",
        "guard",
        "invariant",
        "urgent",
        "deadline",
        "distribution",
        "eft",
        "lft",
    ]
)
_SHARES = frozenset(
    [
        "rate",
        "lambda",
        "mu",
        "weight",
        "probability",
        "priority",
        "server",
        "servers",
        "nservers",
        "capacity",
        "timed",
    ]
)
_DRAWN = frozenset(
    ["display", "show", "label", "unit", "position", "offset", "graphics", "read", "template"]
)
_NOTHING = frozenset(("", "0", "0.0", "false", "none", "true"))
_DEFAULT = _NOTHING | {"1", "1.0", "-1"}


def note_other_timing(specific: etree._Element, what: str, draft: NetDraft) -> None:
    """Note data about times, rates and the like in an element's ``toolspecific``.

    :param what: the element, for the note; each tool and word is noted once.
    """
    tool = specific.get("tool", "")
    if tool in _READ:
        return
    for node in specific.iter():
        if not isinstance(node.tag, str):
            continue
        found = attributes(node)
        parent = node.getparent()
        text = (node.text or "").strip()
        if tag(node) == "value" and node is not specific and parent is not None:
            found[tag(parent)] = text
        elif node is not specific and not len(node):
            found[found.pop("key", "") or tag(node)] = text
        for name, value in found.items():
            words = {word.lower() for word in _PARTS.findall(name.rpartition("}")[2])}
            if words & _DRAWN or name == "rateDefinition":
                continue
            ignored = _NOTHING if words & _TIMES else _DEFAULT if words & _SHARES else None
            if ignored is None or value.strip().lower() in ignored:
                continue
            begin = "'%s' of the tool %s is not used: " % (shorten(name, 30), shorten(tool, 30))
            if not any(note.startswith(begin) for note in draft.notes):
                draft.note("%s%s has %s there" % (begin, what, shorten(value, 30)))
