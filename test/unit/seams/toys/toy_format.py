"""A file format: the words "toy net", then a line for each place (name, tokens) and each arc."""

from __future__ import annotations

from typing import List, Optional, Tuple

from gspn_framework_package.formats import Format, ReadOptions, TextReader
from gspn_framework_package.formats.draft import NetDraft
from gspn_framework_package.model.net import Net


def from_text(text: str, file: Optional[str], options: ReadOptions) -> Tuple[Net, List[str]]:
    draft = NetDraft(file, options.constants)
    for number, line in enumerate(text.splitlines()[1:], 2):
        kind, *words = line.split()
        if kind == "place":
            tokens = draft.count(words[1], "tokens", "place '%s'" % words[0], number)
            draft.add_place(words[0], words[0], tokens, line=number)
        elif kind == "transition":
            draft.add_immediate(words[0], words[0], line=number)
        elif kind == "arc":
            draft.add_arc(None, words[0], words[1], line=number)
        else:
            draft.fail("a line that begins with '%s'" % kind, line=number)
    return draft.net("toy"), draft.notes


def to_bytes(net: Net) -> bytes:
    lines = ["toy net"]
    lines += ["place %s %d" % (place.name, place.tokens) for place in net.places]
    lines += ["transition %s" % transition.name for transition in net.transitions]
    lines += ["arc %s %s" % (arc.source, arc.target) for arc in net.arcs]
    return ("\n".join(lines) + "\n").encode()


FORMAT = Format(
    "toy",
    "toy nets",
    (".toy",),
    to_bytes,
    TextReader(from_text, lambda text: text.startswith("toy net\n")),
)
