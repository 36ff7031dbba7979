"""Kinds of files that users often mistake for a readable net, with advice on what to do instead."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Callable, NamedTuple, Optional, Tuple

from gspn_framework_package.formats.format import NetFile
from gspn_framework_package.formats.pnml_family import TAPAAL, member
from gspn_framework_package.formats.xml_tree import line_of, tag
from gspn_framework_package.model.errors import InputError

if TYPE_CHECKING:
    from lxml import etree


class Foreign(NamedTuple):
    """A kind of file that is recognised only to refuse it with a helpful message.

    :ivar recognises: whether a file is of this kind.
    :ivar message: what the file is.
    :ivar hint: what to do instead.
    :ivar element: finds the element whose line the error names, in an XML file.
    """

    recognises: Callable[[NetFile], bool]
    message: str
    hint: str
    element: Callable[[etree._Element], Optional[etree._Element]] = lambda root: None


def _in_tapaal(file: NetFile) -> bool:
    return file.is_xml and tag(file.root) == "pnml" and member(file.root).kind == TAPAAL


_DRAWN_BY_ND = re.compile(r"\s*[pt]\s+-?[\d.]+\s+-?[\d.]+\s")


FOREIGN: Tuple[Foreign, ...] = (
    Foreign(
        lambda file: not file.is_xml and file.text.lstrip().startswith(("{", "[")),
        "this is JSON, not a net",
        "give a plan to a command that takes one; its net is the file that it names",
    ),
    Foreign(
        lambda file: not file.is_xml and file.text.startswith("|0|"),
        "the old .net/.def format of GreatSPN is not read",
        "open it in the editor of GreatSPN and save it as PNPRO",
    ),
    Foreign(
        lambda file: not file.is_xml and _DRAWN_BY_ND.match(file.text) is not None,
        "a drawing of TINA's editor nd (.ndr), which is not read",
        "save it from nd as .net or PNML",
    ),
    Foreign(
        _in_tapaal,
        "a net in TAPAAL's own form (.tapn), which is not read",
        "save it from TAPAAL as PNML, which leaves its times out",
        lambda root: member(root).shown_by,
    ),
)


def refuse_foreign_file(file: NetFile) -> None:
    """Refuse a file of a known foreign kind. :raises InputError: the file is of such a kind."""
    for kind in FOREIGN:
        if kind.recognises(file):
            element = kind.element(file.root) if file.is_xml else None
            raise InputError(
                kind.message,
                file=file.path,
                line=None if element is None else line_of(element),
                hint=kind.hint,
            )
