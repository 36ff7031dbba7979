"""Opening a plan or net for editing: the document, and the files that it is in."""

from __future__ import annotations

import hashlib
import os
from typing import Callable, Dict, List, NamedTuple, Optional, Tuple

from gspn_framework_package.formats.net_json import net_from_json
from gspn_framework_package.formats.plan_parts import JsonObject, PlanParts, read_parts
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import InputError, RefusedError
from gspn_framework_package.visualizer.documents import Folder, check_size
from gspn_framework_package.visualizer.layout import drawn, lay_out, scale_of

TRIES = 5
"""Number of attempts to read files that change meanwhile."""


class Opened(NamedTuple):
    """A plan or net that is open for editing.

    :ivar path: its file, relative to the served folder.
    :ivar parts: the contents of the files.
    :ivar document: the edited parts: ``plan``, ``net`` with a position for each node, ``policy``.
    :ivar etag: a hash of all its files.
    :ivar laid_out: whether the positions are those of a layout, not of the file.
    :ivar scale: factor from the positions to those of the page, whose symbols have a fixed size.
    """

    path: str
    parts: PlanParts
    document: JsonObject
    etag: str
    laid_out: bool
    scale: float

    def files_to_json(self) -> Dict[str, Optional[str]]:
        """File name of each part, next to the plan; None: no file of its own."""
        parts = self.parts
        folder = os.path.dirname(parts.plan_file or parts.net_file)
        return {
            key: os.path.relpath(file, folder) if file else None
            for key, file in (
                ("plan", parts.plan_file),
                ("net", parts.net_file),
                ("policy", parts.policy_file),
            )
        }


def open_document(folder: Folder, path: str) -> Opened:
    """Open the plan or net at ``path``, which is relative to the served folder.

    :raises GspnError: it cannot be read, or is outside the folder.
    """
    name = folder.name(path)
    if folder.kind(name) == "log":
        raise RefusedError("a recorded run is not edited", hint="open its plan", file=name)
    whole = folder.resolve(name)
    for _ in range(TRIES):
        parts = read_parts(whole, folder.root)
        etag = etag_of(folder, parts.files)
        again = read_parts(whole, folder.root)
        if again == parts and etag_of(folder, parts.files) == etag:
            return _opened(name, parts, etag)
    raise InputError("it keeps changing", file=name, hint="try again")


def _opened(name: str, parts: PlanParts, etag: str) -> Opened:
    nodes = len(parts.net["places"]) + len(parts.net["transitions"])
    check_size(nodes, len(parts.net["arcs"]), name)
    net, laid_out = with_positions(parts.net)
    document = {"plan": parts.plan, "net": net, "policy": parts.policy}
    spots = [tuple(node["position"]) for node in (*net["places"], *net["transitions"])]
    scale = 1.0 if laid_out else scale_of(spots)
    return Opened(name, parts, document, etag, laid_out, scale)


def etag_of(folder: Folder, files: List[str]) -> str:
    """The hash over the names and the content of files."""
    digest = hashlib.sha256()
    for file in files:
        data = read_bytes(file)
        name = os.path.relpath(file, folder.root)
        digest.update(b"%d %s %d " % (len(name), name.encode(errors="replace"), len(data)) + data)
    return digest.hexdigest()


def with_positions(net: JsonObject) -> Tuple[JsonObject, bool]:
    """The net with a position for each node, and whether all positions come from a layout.

    Positions of the file are kept as they are.
    """
    nodes = [*net["places"], *net["transitions"]]
    given = drawn({n["name"]: tuple(n["position"]) if n.get("position") else None for n in nodes})
    laid_out = given is None and bool(nodes)
    positions = lay_out(net_from_json(net)).positions if given is None else given

    def placed(node: JsonObject) -> JsonObject:
        if node.get("position") is not None and not laid_out:
            return node
        x, y = positions[node["name"]]
        return {**node, "position": [round(x, 1), round(y, 1)]}

    return with_nodes(net, placed), laid_out


def with_nodes(net: JsonObject, change: Callable[[JsonObject], JsonObject]) -> JsonObject:
    """The net with each of its nodes changed."""
    return {
        **net,
        **{key: [change(node) for node in net[key]] for key in ("places", "transitions")},
    }
