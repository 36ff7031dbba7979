"""All net formats in one table: which one a file is in, reading it, writing it."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple, Union

from lxml import etree

from gspn_framework_package.formats import dot, jani, pipe, pnml, pnpro, prism, tina
from gspn_framework_package.formats.draft import NO_CONSTANTS, ReadOptions
from gspn_framework_package.formats.source import read_bytes, write_bytes
from gspn_framework_package.formats.xml_tree import line_of, parse_xml, tag
from gspn_framework_package.model.errors import GspnError, InputError, UsageError
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.model.net import Net

PathLike = Union[str, "Path"]
_XmlReader = Callable[[etree._Element, Optional[str], ReadOptions], Tuple[Net, List[str]]]
_TextReader = Callable[[str, Optional[str], ReadOptions], Tuple[Net, List[str]]]


NO_BOUNDS: Mapping[str, int] = {}


class Format(NamedTuple):
    """A file format.

    :ivar name: what it is called in ``--to`` and ``format=``.
    :ivar title: what it is called in sentences.
    :ivar extensions: how its files end; the first is the usual one.
    :ivar from_xml: the reader, of an XML format.
    :ivar from_text: the reader, of a text format.
    :ivar to_bytes: the writer: of a net, and where ``takes_bounds`` of the most tokens that places
      hold.
    :ivar losses: what writing a net leaves out or says in other words, in sentences.
    """

    name: str
    title: str
    extensions: Tuple[str, ...]
    to_bytes: Callable[..., bytes]
    from_xml: Optional[_XmlReader] = None
    from_text: Optional[_TextReader] = None
    losses: Callable[[Net], List[str]] = lambda net: []
    takes_bounds: bool = False

    @property
    def is_read(self) -> bool:
        """Whether there is a reader."""
        return self.from_xml is not None or self.from_text is not None


_TABLE = (
    Format("pipe", "PIPE XML", (".xml",), pipe.to_bytes, from_xml=pipe.from_xml),
    Format("pnml", "ISO 15909-2 PNML", (".pnml",), pnml.to_bytes, from_xml=pnml.from_xml),
    Format(
        "pnpro",
        "PNPRO (GreatSPN)",
        (".pnpro",),
        pnpro.to_bytes,
        from_xml=pnpro.from_xml,
        losses=pnpro.losses,
    ),
    Format(
        "tina", "TINA .net", (".net",), tina.to_bytes, from_text=tina.from_text, losses=tina.losses
    ),
    Format("jani", "JANI", (".jani",), jani.to_bytes, takes_bounds=True),
    Format("prism", "PRISM", (".prism", ".sm"), prism.to_bytes, takes_bounds=True),
    Format("dot", "Graphviz DOT", (".dot", ".gv"), dot.to_bytes),
)

FORMATS: Mapping[str, Format] = {f.name: f for f in _TABLE}
"""Format name -> format."""

_READ = "read are %s" % ", ".join(f.title for f in FORMATS.values() if f.is_read)


def read_net(
    path: PathLike,
    *,
    format: Optional[str] = None,
    net: Optional[str] = None,
    constants: Mapping[str, float] = NO_CONSTANTS,
    infinite_servers: Optional[bool] = None,
    missing_weight: float = 1.0,
) -> Net:
    """The net of a file, in any format that is known; the format is told by the content.

    :param format: a name in :data:`FORMATS`, when it should not be guessed.
    :param net: the name of the net to take from a file of several.
    :param constants: values of constants; they go before those of the file.
    :param infinite_servers: whether exponential transitions whose file does not say have infinitely
        many servers; None takes the default of the format (PNPRO: infinitely many, others: one).
    :param missing_weight: weight of immediate transitions whose file gives none: 1, or 0 for
        "controllable".
    :raises InputError: the file cannot be read, or is not a net; the message says where and why.
    """
    return read_net_with_notes(
        path,
        format=format,
        net=net,
        constants=constants,
        infinite_servers=infinite_servers,
        missing_weight=missing_weight,
    )[0]


def read_net_with_notes(
    path: PathLike,
    *,
    format: Optional[str] = None,
    net: Optional[str] = None,
    constants: Mapping[str, float] = NO_CONSTANTS,
    infinite_servers: Optional[bool] = None,
    missing_weight: float = 1.0,
) -> Tuple[Net, List[str]]:
    """As :func:`read_net`, and notes on what had to be assumed or was left out."""
    options = ReadOptions(net, constants, infinite_servers, missing_weight)
    wanted = format_named(format) if format is not None else None
    if wanted is not None and not wanted.is_read:
        raise UsageError("%s is written, not read" % wanted.title, hint=_READ)
    file = str(path)
    data = read_bytes(file)
    try:
        _check_constants(data, constants)
        return _read(data, file, wanted, options)
    except GspnError as error:
        raise error.located(file=file) from None


def _check_constants(data: bytes, constants: Mapping[str, float]) -> None:
    """:raises UsageError: a constant that no word of the file is: a slip of the pen, which would
    change nothing."""
    for name in constants:
        word = re.escape(name).encode(errors="surrogateescape")
        if b"\0" not in data and not re.search(rb"(?<!\w)%s(?!\w)" % word, data):
            raise UsageError(
                "the constant '%s' does not occur in the file" % name,
                hint="is it spelt as it is there?",
            )


def write_net(
    net: Net, path: PathLike, format: Optional[str] = None, bounds: Mapping[str, int] = NO_BOUNDS
) -> List[str]:
    """Write a net; the format is told by the name of the file unless given.

    :param bounds: the most tokens that places can hold, where known; model checkers want to know.
    :returns: what the format could not hold, in sentences.
    :raises UsageError: the format is not known.
    :raises NetError: the net has something that the format cannot say.
    :raises InputError: the file cannot be written.
    """
    chosen = format_named(format) if format is not None else format_of_name(path)
    data, losses = encode_net(net, chosen, bounds)
    write_bytes(str(path), data)
    return losses


def encode_net(
    net: Net, format: Format, bounds: Mapping[str, int] = NO_BOUNDS
) -> Tuple[bytes, List[str]]:
    """The content of a file, and what the format could not hold, in sentences.

    :raises NetError: the net has something that the format cannot say.
    """
    data = format.to_bytes(net, bounds) if format.takes_bounds else format.to_bytes(net)
    return data, format.losses(net)


def format_of_name(path: PathLike) -> Format:
    """The format that the name of a file stands for.

    :raises UsageError: it stands for none.
    """
    suffix = Path(path).suffix.lower()
    for entry in FORMATS.values():
        if suffix in entry.extensions:
            return entry
    known = ", ".join("%s (%s)" % (f.name, f.extensions[0]) for f in FORMATS.values())
    raise UsageError(
        "cannot tell the format from the name '%s'" % path, hint="name one with --to: %s" % known
    )


def format_named(name: str) -> Format:
    """The format of that name. :raises UsageError: there is none."""
    try:
        return FORMATS[name.lower()]
    except KeyError:
        raise UsageError(
            "there is no format '%s'" % name, hint="known: %s" % ", ".join(FORMATS)
        ) from None


def _read(
    data: bytes, file: str, wanted: Optional[Format], options: ReadOptions
) -> Tuple[Net, List[str]]:
    if not data.strip():
        raise InputError("the file is empty", file=file)
    if wanted is not None and wanted.from_text is not None:
        return wanted.from_text(_decode(data, file), file, options)
    if wanted is not None or is_xml(data):
        root = parse_xml(data, file)
        chosen = wanted or _format_of_xml(root, file)
        _check_root(root, chosen, file)
        assert chosen.from_xml is not None
        return chosen.from_xml(root, file, options)
    text = _decode(data, file)
    if text.lstrip().startswith(("{", "[")):
        raise InputError(
            "this is JSON, not a net",
            file=file,
            hint="a plan is given where a plan is asked for; its net is the file it names",
        )
    if text.startswith("|0|"):
        raise InputError(
            "the old .net/.def format of GreatSPN is not read",
            file=file,
            hint="open it in the editor of GreatSPN and save it as PNPRO",
        )
    if tina.recognises(text):
        return tina.from_text(text, file, options)
    raise InputError(
        "not a net in any format that is known",
        file=file,
        hint=_READ,
    )


def is_xml(data: bytes) -> bool:
    """Whether a file with this content is meant as XML."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return True
    if data.startswith(codecs.BOM_UTF8):
        data = data[len(codecs.BOM_UTF8) :]
    return data.lstrip()[:1] == b"<"


def _decode(data: bytes, file: str) -> str:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(
            "neither XML nor text: not a net in any format that is known",
            file=file,
            hint=_READ,
        ) from None
    if "\0" in text:
        raise InputError("neither XML nor text: not a net in any format that is known", file=file)
    return text


_ROOTS: Dict[str, Tuple[str, ...]] = {
    "pipe": ("pnml", "net"),
    "pnml": ("pnml",),
    "pnpro": ("project", "gspn"),
}


def _check_root(root: etree._Element, chosen: Format, file: str) -> None:
    expected = _ROOTS[chosen.name]
    if tag(root) not in expected:
        raise InputError(
            "the root element is <%s>, not <%s> as in %s"
            % (shorten(tag(root)), expected[0], chosen.title),
            file=file,
            line=line_of(root),
        )


def _format_of_xml(root: etree._Element, file: str) -> Format:
    """Which XML format a document is in. PIPE and ISO PNML share the root and most tags; PIPE has
    its numbers in ``value`` elements, ISO in ``text`` elements."""
    name = tag(root)
    if name in ("project", "gspn"):
        return FORMATS["pnpro"]
    if name == "net":
        return FORMATS["pipe"]
    if name != "pnml":
        raise InputError(
            "the root element is <%s>, which is no net format that is known" % shorten(name),
            file=file,
            line=line_of(root),
            hint=_READ,
        )
    for element in root.iter():
        kind = tag(element)
        parent = element.getparent()
        if (
            kind in ("value", "text")
            and parent is not None
            and tag(parent) in ("name", "initialMarking", "inscription", "rate", "timed")
        ):
            return FORMATS["pipe" if kind == "value" else "pnml"]
        if kind == "page":
            return FORMATS["pnml"]
        if kind == "place" and element.get("initialMarking") is not None:
            raise InputError(
                "a net in TAPAAL's own form (.tapn), which is not read",
                file=file,
                line=line_of(element),
                hint="save it from TAPAAL as PNML, which leaves its times out",
            )
    return FORMATS[
        "pnml" if (root.nsmap.get(None) or "").startswith("http://www.pnml.org") else "pipe"
    ]
