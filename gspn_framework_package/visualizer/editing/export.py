"""Exports: the plan folder as a zip archive, or its net in any supported format. Pictures are made
by the page, as the net is drawn."""

from __future__ import annotations

import io
import re
import zipfile
from typing import Dict, List, NamedTuple

from gspn_framework_package.formats.net_json import net_from_json
from gspn_framework_package.formats.registry import FORMATS, encode_net
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.visualizer.editing.plan_repository import PlanRepository
from gspn_framework_package.visualizer.editing.saving import document_in


class Export(NamedTuple):
    """A file for the browser, and notes on what its format cannot express."""

    name: str
    mimetype: str
    data: bytes
    notes: List[str]


def exported(repository: PlanRepository, path: str, document: object, format: object) -> Export:
    """Export a document as it is in the browser, saved or not.

    :param format: ``zip``, or the name of a net format.
    :raises GspnError: it cannot be written in that format.
    """
    new = document_in(document)
    known = ["zip", *FORMATS]
    if not isinstance(format, str) or format not in known:
        raise UsageError("there is no such format", hint="the formats are %s" % ", ".join(known))
    name = re.sub(r"[^A-Za-z0-9_.+-]", "_", str(new["plan"].get("plan") or "plan"))[:80]
    if format == "zip":
        contents = repository.everything_of(path, document)
        return Export(name + ".zip", "application/zip", _zipped(name, contents), [])
    net = net_from_json(new["net"])
    data, losses = encode_net(net, FORMATS[format])
    ending = FORMATS[format].extensions[0]
    return Export(name + ending, "application/octet-stream", data, losses)


def _zipped(name: str, contents: Dict[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for inner, data in sorted(contents.items()):
            archive.writestr("%s/%s" % (name, inner), data)
    return file.getvalue()
