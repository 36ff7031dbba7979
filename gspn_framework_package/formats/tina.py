"""The textual ``.net`` format of TINA: read and write.

::

    net {a name}
    pl p1 (2)
    tr t1 [0,w[ p1*2 p2?-1 -> p3
    tr t2 [0,0] p3?1 -> p1

The format has time intervals, not rates. A transition with ``[0,0]`` is immediate, one with
``[0,w[`` or no interval is exponential with rate 1; other intervals, stopwatch arcs and priorities
are refused. A test arc ``?n`` becomes a pair of arcs in both directions, which is equivalent. The
writer leaves out rates, weights, priorities and numbers of servers; :func:`losses` reports that."""

from __future__ import annotations

import re
from typing import Dict, List, NamedTuple, NoReturn, Optional, Tuple

from gspn_framework_package.formats.draft import NetDraft, ReadOptions, capacity_losses
from gspn_framework_package.model.capacity import capacities_as_inhibitors
from gspn_framework_package.model.errors import NetError
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.model.net import Net

_PLAIN = re.compile(r"[A-Za-z0-9_']+\Z")
_WORD = re.compile(
    r"""\s*(?:
        (?P<name>[A-Za-z0-9_'][\w'.]*|\{(?:[^{}\\]|\\.)*\})
      | (?P<arrow>->)
      | (?P<arc>(?:\*|\?-|\?|!-|!)\d+[KMGTPE]?)
      | (?P<interval>[\[\]]\s*\d+\s*,\s*(?:\d+\s*[\[\]]|w\s*\[))
      | (?P<marking>\(\d+[KMGTPE]?\))
      | (?P<colon>:)
      | (?P<order>[<>])
    )""",
    re.VERBOSE,
)
_FACTORS = {"K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12, "P": 10**15, "E": 10**18}
_MAX_DIGITS = 30


class _Word(NamedTuple):
    kind: str
    text: str


class _Arc(NamedTuple):
    node: str
    kind: str  # "*", "?" or "?-"
    weight: int


def recognises(text: str) -> bool:
    """Whether a text looks like a TINA net, that is, whether its first word is a TINA keyword."""
    for line in text.splitlines()[:1000]:
        line = line.strip()
        if line and not line.startswith("#"):
            return line.split()[0] in ("net", "tr", "pl", "lb", "pr", "nt")
    return False


def from_text(text: str, file: Optional[str], options: ReadOptions) -> Tuple[Net, List[str]]:
    """Read the net in a text, with notes.

    :raises NetError: the text is not a TINA net, or has time intervals other than ``[0,0]`` and
        ``[0,w[``.
    """
    reader = _Reader(file, options)
    for number, line in enumerate(text.splitlines(), 1):
        reader.read_line(line, number)
    return reader.net()


class _Reader:
    """Reads the lines in one pass; nodes may be declared by use, and more than once."""

    def __init__(self, file: Optional[str], options: ReadOptions) -> None:
        self.draft = NetDraft(file, options.constants)
        self.options = options
        self.name = ""
        self.tokens: Dict[str, Tuple[int, int]] = {}  # place -> (tokens, line)
        self.immediate: Dict[str, Tuple[bool, int]] = {}  # transition -> (immediate, line)
        self.words: List[_Word] = []
        self.line = 0

    def read_line(self, line: str, number: int) -> None:
        """Read one line of the file."""
        self.line = number
        if not line.strip() or line.lstrip().startswith("#"):
            return
        keyword, _, rest = line.strip().partition(" ")
        if keyword in ("nt", "lb"):  # notes and labels are ignored
            return
        if keyword == "pr":
            self._fail("priorities between pairs of transitions are not read")
        if keyword not in ("net", "tr", "pl"):
            self._fail(
                "a line that begins with '%s'" % shorten(keyword, 20),
                "lines begin with net, pl, tr, lb or nt",
            )
        self.words = list(reversed(self._split(rest)))
        if keyword == "net":
            self.name = self._name("net")
        elif keyword == "tr":
            self._transition()
        else:
            self._place()
        if self.words:
            self._fail("'%s' is not possible there" % shorten(self.words[-1].text, 30))

    def net(self) -> Tuple[Net, List[str]]:
        """Return the net that was read, and notes."""
        for name, (tokens, line) in self.tokens.items():
            self.draft.add_place(None, name, tokens, line=line)
        for name, (immediate, line) in self.immediate.items():
            if immediate:
                self.draft.add_immediate(None, name, self.options.missing_weight, line=line)
            else:
                self.draft.add_exponential(None, name, 1.0, self.options.servers(1), line=line)
        self.draft.note(
            "the format has no rates and weights: exponential with rate 1, "
            "immediate ([0,0]) with weight %g" % self.options.missing_weight
        )
        return self.draft.net(self.name), self.draft.notes

    def _split(self, text: str) -> List[_Word]:
        words = []
        at = 0
        text = text.rstrip()
        while at < len(text):
            match = _WORD.match(text, at)
            if match is None:
                self._fail("'%s' cannot be read" % shorten(text[at:].strip(), 20))
            kind = match.lastgroup or ""
            words.append(_Word(kind, match.group(kind)))
            at = match.end()
        return words

    def _transition(self) -> None:
        name = self._name("transition")
        self._skip_label()
        immediate = False
        interval = self._take("interval")
        if interval is not None:
            bounds = re.sub(r"\s", "", interval)
            if bounds not in ("[0,0]", "[0,w["):
                self._fail(
                    "transition '%s' has the time interval %s" % (name, bounds),
                    "[0,w[ (any time) and [0,0] (immediate) are read",
                )
            immediate = bounds == "[0,0]"
        known = self.immediate.get(name)
        if known is None or interval is not None:
            self.immediate[name] = (immediate, self.line)
        inputs, outputs = self._sides()
        for place, kind, weight in inputs:
            self.tokens.setdefault(place, (0, self.line))
            self._connect(place, name, kind, weight)
        for place, kind, weight in outputs:
            self.tokens.setdefault(place, (0, self.line))
            self._output(name, place, kind, weight)

    def _place(self) -> None:
        name = self._name("place")
        self._skip_label()
        marking = self._take("marking")
        before = self.tokens.get(name, (0, self.line))[0]
        added = self._count(marking[1:-1]) if marking else 0
        self.tokens[name] = (before + added, self.line)
        inputs, outputs = self._sides()
        for transition, kind, weight in inputs:
            self.immediate.setdefault(transition, (False, self.line))
            self._output(transition, name, kind, weight)
        for transition, kind, weight in outputs:
            self.immediate.setdefault(transition, (False, self.line))
            self._connect(name, transition, kind, weight)

    def _connect(self, place: str, transition: str, kind: str, weight: int) -> None:
        if kind in ("*", "?"):
            self.draft.add_arc(None, place, transition, weight, line=self.line)
        if kind == "?":
            self.draft.add_arc(None, transition, place, weight, line=self.line)
        if kind == "?-":
            self.draft.add_arc(None, place, transition, weight, True, line=self.line)

    def _output(self, transition: str, place: str, kind: str, weight: int) -> None:
        if kind != "*":
            self._fail("an arc to place '%s' cannot be a test arc" % place)
        self.draft.add_arc(None, transition, place, weight, line=self.line)

    def _sides(self) -> Tuple[List[_Arc], List[_Arc]]:
        if not self.words:
            return [], []
        before = self._arcs()
        if self._take("arrow") is None:
            self._fail("'->' was expected")
        return before, self._arcs()

    def _arcs(self) -> List[_Arc]:
        arcs = []
        while self.words and self.words[-1].kind == "name":
            node = self._name("place")
            text = self._take("arc") or "*1"
            kind = text.rstrip("0123456789KMGTPE")
            if kind.startswith("!"):
                self._fail("stopwatch arcs are not read")
            arcs.append(_Arc(node, kind, self._count(text[len(kind) :])))
        return arcs

    def _count(self, text: str) -> int:
        if len(text) > _MAX_DIGITS:
            self._fail("a number of %d digits" % len(text))
        return int(text.rstrip("KMGTPE")) * _FACTORS.get(text[-1], 1)

    def _skip_label(self) -> None:
        if self._take("colon") is not None:
            self._name("label")

    def _take(self, kind: str) -> Optional[str]:
        if self.words and self.words[-1].kind == kind:
            return self.words.pop().text
        return None

    def _name(self, what: str) -> str:
        text = self._take("name")
        if text is None:
            self._fail("the name of a %s was expected" % what)
        return re.sub(r"\\(.)", r"\1", text[1:-1]) if text.startswith("{") else text

    def _fail(self, message: str, hint: Optional[str] = None) -> NoReturn:
        self.draft.fail(message, line=self.line, hint=hint)


# -- writing -------------------------------------------------------------------------------------


def losses(net: Net) -> List[str]:
    """Return notes for the user on what the format cannot express of this net."""
    found = capacity_losses(net)
    if net.transitions:
        found.append(
            "rates, weights, priorities and numbers of servers are left out: TINA has none"
        )
    return found


def to_bytes(net: Net) -> bytes:
    """Return the net as TINA reads it; capacities become equivalent inhibitor arcs.

    :raises NetError: a name has a line break.
    """
    net = capacities_as_inhibitors(net)
    lines = ["net %s" % _quote(net.name or "net")]
    for place in net.places:
        lines.append("pl %s (%d)" % (_quote(place.name), place.tokens))
    inputs: Dict[str, List[str]] = {t.name: [] for t in net.transitions}
    outputs: Dict[str, List[str]] = {t.name: [] for t in net.transitions}
    for arc in net.arcs:
        if arc.source in net.place_index:
            kind = "?-" if arc.inhibitor else "*"
            inputs[arc.target].append("%s%s%d" % (_quote(arc.source), kind, arc.weight))
        else:
            outputs[arc.source].append("%s*%d" % (_quote(arc.target), arc.weight))
    for transition in net.transitions:
        interval = "[0,w[" if transition.timed else "[0,0]"
        sides = "%s -> %s" % (" ".join(inputs[transition.name]), " ".join(outputs[transition.name]))
        lines.append(("tr %s %s %s" % (_quote(transition.name), interval, sides)).rstrip())
    return ("\n".join(lines) + "\n").encode("utf-8")


def update_text(text: str, old: Net, new: Net) -> str:
    """Return the text of a file with the net ``old``, changed so that it holds ``new``: lines of
    places and transitions that did not change stay, as do notes and comments.

    :raises NetError: changing such a file is not supported: it has arcs in lines of places, several
        lines for a node, or labels.
    """
    end = "\r\n" if "\r\n" in text else "\n"
    lines = text.splitlines()
    found: Dict[Tuple[str, str], int] = {}
    reader = _Reader(None, ReadOptions())
    for number, line in enumerate(lines):
        keyword, _, rest = line.strip().partition(" ")
        if keyword == "lb":
            raise NetError("it has labels")
        if keyword not in ("pl", "tr"):
            continue
        reader.words = list(reversed(reader._split(rest)))
        name = reader._name(keyword)
        arrow = any(word.kind in ("arrow", "colon") for word in reader.words)
        if (keyword, name) in found or keyword == "pl" and arrow:
            raise NetError("it is not a plain list of places and transitions", element=name)
        found[keyword, name] = number
    written: Dict[Tuple[bool, str, str], str] = {}
    for whole in (old, new):
        for line in to_bytes(whole).decode("utf-8").splitlines():
            reader.words = list(reversed(reader._split(line.partition(" ")[2])))
            keyword = line.partition(" ")[0]
            written[whole is new, keyword, reader._name(keyword)] = line
    result: Dict[int, str] = {}
    for (keyword, name), number in found.items():
        if (True, keyword, name) not in written:
            result[number] = ""
        elif written[True, keyword, name] != written.get((False, keyword, name)):
            result[number] = written[True, keyword, name]
    added = [
        line
        for (is_new, keyword, name), line in written.items()
        if is_new
        and keyword != "net"
        and (keyword, name) not in found
        and line != written.get((False, keyword, name))  # a place that only transitions name
    ]
    kept = [
        result.get(number, line) for number, line in enumerate(lines) if result.get(number) != ""
    ]
    return end.join([*kept, *added]) + (end if text.endswith("\n") or added else "")


def _quote(name: str) -> str:
    if len(name.splitlines()) > 1 or name.splitlines() != [name]:
        raise NetError(
            "a name with a line break cannot be written in TINA's format",
            element="'%s'" % shorten(name),
        )
    return name if _PLAIN.match(name) else "{%s}" % re.sub(r"([{}\\])", r"\\\1", name)


def update(data: bytes, options: ReadOptions, old: Net, new: Net) -> bytes:
    """Change the net in a file; see :data:`~gspn_framework_package.formats.format.Updater`."""
    mark = b"\xef\xbb\xbf" if data.startswith(b"\xef\xbb\xbf") else b""
    return mark + update_text(data.decode("utf-8-sig"), old, new).encode("utf-8")
