"""The table of all net formats, and functions to recognise, read and write net files.

The module of a format is imported when a file of its kind is read or written.
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple, Union

from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.foreign import refuse_foreign_file
from gspn_framework_package.formats.format import (
    Bounds,
    Format,
    NetAndNotes,
    NetFile,
    TextReader,
    XmlReader,
)
from gspn_framework_package.formats.pnml_family import PIPE, PNML, member
from gspn_framework_package.formats.source import read_bytes, write_bytes
from gspn_framework_package.formats.xml_tree import line_of, tag
from gspn_framework_package.model.errors import GspnError, InputError, UsageError
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.model.net import Net

PathLike = Union[str, "Path"]

NO_BOUNDS: Bounds = {}
AS_THE_FILE_SAYS = ReadOptions()

MIN_BYTES = 1_000_000
"""Size (bytes) of a PNML file from which on it pays to look for repetition."""

FORMATS: Dict[str, Format] = {}
"""Format name -> format, in the order in which the formats are tried on a file."""


def register(format: Format) -> None:
    """Add a format, so that its files can be used wherever nets are read or written.

    :raises ValueError: another format has the same name or one of its extensions.
    """
    for other in FORMATS.values():
        shared = set(format.extensions).intersection(other.extensions)
        if format.name == other.name or shared:
            raise ValueError(
                "the format '%s' shares its name or an extension with '%s'"
                % (format.name, other.name)
            )
    FORMATS[format.name] = format


def _of(module: str, function: str) -> Callable[..., Any]:
    """A function of a module in this folder, imported by the first call."""

    def call(*arguments: Any) -> Any:
        return getattr(import_module("%s.%s" % (__package__, module)), function)(*arguments)

    return call


for _format in (
    Format(
        "pipe",
        "PIPE XML",
        (".xml",),
        _of("pipe", "to_bytes"),
        XmlReader(
            _of("pipe", "from_xml"),
            ("pnml", "net"),
            lambda root: tag(root) == "net" or member(root).kind == PIPE,
        ),
        update=_of("pipe_update", "update"),
    ),
    Format(
        "pnml",
        "ISO 15909-2 PNML",
        (".pnml",),
        _of("pnml", "to_bytes"),
        XmlReader(_of("pnml", "from_xml"), ("pnml",), lambda root: member(root).kind == PNML),
        update=_of("pnml_update", "update"),
    ),
    Format(
        "pnpro",
        "PNPRO (GreatSPN)",
        (".pnpro",),
        _of("pnpro", "to_bytes"),
        XmlReader(_of("pnpro", "from_xml"), ("project", "gspn")),
        _of("pnpro", "losses"),
        update=_of("pnpro_update", "update"),
    ),
    Format(
        "tina",
        "TINA .net",
        (".net",),
        _of("tina", "to_bytes"),
        TextReader(_of("tina", "from_text"), _of("tina", "recognises")),
        _of("tina", "losses"),
        update=_of("tina", "update"),
    ),
    Format("jani", "JANI", (".jani",), _of("jani", "to_bytes"), takes_bounds=True),
    Format("prism", "PRISM", (".prism", ".sm"), _of("prism", "to_bytes"), takes_bounds=True),
    Format("dot", "Graphviz DOT", (".dot", ".gv"), _of("dot", "to_bytes")),
):
    register(_format)


def read_net(path: PathLike, options: ReadOptions = AS_THE_FILE_SAYS, **fields: Any) -> Net:
    """Read the net of a file in any known format; the content decides which format it is.

    :param options: how to read the net.
    :param fields: fields of the options, by name: ``read_net(path, net="machine")``.
    :raises InputError: the file cannot be read, or is not a net; the message says where and why.
    """
    return read_net_with_notes(path, options, **fields)[0]


def read_net_with_notes(
    path: PathLike, options: ReadOptions = AS_THE_FILE_SAYS, **fields: Any
) -> NetAndNotes:
    """As :func:`read_net`, but also return notes on what was assumed or left out."""
    options = options._replace(**fields)
    if options.format is not None and format_named(options.format).reader is None:
        raise UsageError(
            "%s is written, not read" % format_named(options.format).title, hint=_formats_read()
        )
    return net_from_bytes(read_bytes(str(path)), str(path), options)


def net_from_bytes(data: bytes, name: str, options: ReadOptions = AS_THE_FILE_SAYS) -> NetAndNotes:
    """Read the net in the content of a file, and notes on what was assumed or left out.

    :param name: the name of the file, for errors.
    :raises InputError: it is not a net.
    """
    file = NetFile(data, name, _formats_read())
    try:
        _check_constants(file.data, options.constants)
        return _read_sample(file, options) or _read(file, options)
    except GspnError as error:
        raise error.located(file=file.path) from None


def _read_sample(file: NetFile, options: ReadOptions) -> Optional[NetAndNotes]:
    """Read a large file that repeats itself; None if it does not, or if it has errors, which
    :func:`_read` then reports."""
    format = options.format
    if len(file.data) < MIN_BYTES or format not in (None, "pnml") or not file.is_xml:
        return None
    from gspn_framework_package.formats.repetition import sample_of

    sample = sample_of(file.data)
    if sample is None:
        return None
    from gspn_framework_package.formats.pnml import from_sample

    try:
        return from_sample(sample, options)
    except GspnError:
        return None


def _check_constants(data: bytes, constants: Mapping[str, float]) -> None:
    """Check that the file uses these constants.

    :raises UsageError: a constant does not occur in the file (probably a typo).
    """
    for name in constants:
        word = re.escape(name).encode(errors="surrogateescape")
        if b"\0" not in data and not re.search(rb"(?<!\w)%s(?!\w)" % word, data):
            raise UsageError(
                "the constant '%s' does not occur in the file" % name, hint="check its spelling"
            )


def _read(file: NetFile, options: ReadOptions) -> NetAndNotes:
    if not file.data.strip():
        raise InputError("the file is empty", file=file.path)
    format = _recognise(file) if options.format is None else format_named(options.format)
    assert format.reader is not None
    return format.reader.read_file(file, format.title, options)


def _recognise(file: NetFile) -> Format:
    """Recognise the format of a file by its content. :raises InputError: the format is unknown."""
    refuse_foreign_file(file)
    for format in FORMATS.values():
        if format.reader is not None and format.reader.takes(file):
            return format
    if file.is_xml:
        raise InputError(
            "the root element <%s> belongs to no known net format" % shorten(tag(file.root)),
            file=file.path,
            line=line_of(file.root),
            hint=_formats_read(),
        )
    raise InputError("not a net in any format that is known", file=file.path, hint=_formats_read())


def _formats_read() -> str:
    return "known formats: %s" % ", ".join(
        f.title for f in FORMATS.values() if f.reader is not None
    )


def write_net(
    net: Net, path: PathLike, format: Optional[str] = None, bounds: Bounds = NO_BOUNDS
) -> List[str]:
    """Write a net; the file's name determines the format unless ``format`` is given.

    :param bounds: the maximum number of tokens of places, where known; for model checkers.
    :returns: what the format could not express, in sentences.
    :raises UsageError: the format is not known.
    :raises NetError: the net has something that the format cannot express.
    :raises InputError: the file cannot be written.
    """
    chosen = format_named(format) if format is not None else format_of_name(path)
    data, losses = encode_net(net, chosen, bounds)
    write_bytes(str(path), data)
    return losses


def encode_net(net: Net, format: Format, bounds: Bounds = NO_BOUNDS) -> Tuple[bytes, List[str]]:
    """Return the content of a file, and what the format could not express, in sentences.

    :raises NetError: the net has something that the format cannot express.
    """
    data = format.to_bytes(net, bounds) if format.takes_bounds else format.to_bytes(net)
    return data, format.losses(net)


def format_of_name(path: PathLike) -> Format:
    """Return the format that the name of a file implies.

    :raises UsageError: the name implies none.
    """
    suffix = Path(path).suffix.lower()
    for entry in FORMATS.values():
        if suffix in entry.extensions:
            return entry
    known = ", ".join("%s (%s)" % (f.name, f.extensions[0]) for f in FORMATS.values())
    raise UsageError(
        "the name '%s' does not show the format" % path, hint="choose one with --to: %s" % known
    )


def format_named(name: str) -> Format:
    """Return the format of that name. :raises UsageError: there is none."""
    try:
        return FORMATS[name.lower()]
    except KeyError:
        raise UsageError(
            "there is no format '%s'" % name, hint="known: %s" % ", ".join(FORMATS)
        ) from None
