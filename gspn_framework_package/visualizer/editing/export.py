"""Exports: the plan folder as a zip archive, its net in any supported format, or a picture."""

from __future__ import annotations

import io
import re
import zipfile
from typing import Dict, List, NamedTuple

from gspn_framework_package.formats.dot import net_graph, render
from gspn_framework_package.formats.net_json import net_from_json
from gspn_framework_package.formats.registry import FORMATS, encode_net
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.visualizer.editing.plan_repository import PlanRepository
from gspn_framework_package.visualizer.editing.saving import document_in

PICTURE_TIME = 30.0
"""Longest time for a picture, in seconds."""


class Export(NamedTuple):
    """A file for the browser, and notes on what its format cannot express."""

    name: str
    mimetype: str
    data: bytes
    notes: List[str]


def exported(repository: PlanRepository, path: str, document: object, format: object) -> Export:
    """Export a document as it is in the browser, saved or not.

    :param format: ``zip``, ``svg``, or the name of a net format.
    :raises GspnError: it cannot be written in that format.
    """
    new = document_in(document)
    known = ["zip", "svg", *FORMATS]
    if not isinstance(format, str) or format not in known:
        raise UsageError("there is no such format", hint="the formats are %s" % ", ".join(known))
    name = re.sub(r"[^A-Za-z0-9_.+-]", "_", str(new["plan"].get("plan") or "plan"))[:80]
    if format == "zip":
        contents = repository.everything_of(path, document)
        return Export(name + ".zip", "application/zip", _zipped(name, contents), [])
    net = net_from_json(new["net"])
    if format == "svg":
        data = render(net_graph(net).text(), "svg", PICTURE_TIME)
        return Export(name + ".svg", "image/svg+xml", data, [])
    data, losses = encode_net(net, FORMATS[format])
    ending = FORMATS[format].extensions[0]
    return Export(name + ending, "application/octet-stream", data, losses)


def _zipped(name: str, contents: Dict[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for inner, data in sorted(contents.items()):
            archive.writestr("%s/%s" % (name, inner), data)
    return file.getvalue()
