"""Opening a plan or net for editing: the document, and the files that it is in."""

from __future__ import annotations

import hashlib
import math
import os
from typing import Callable, Dict, List, NamedTuple, Optional, Tuple

from gspn_framework_package.formats.net_json import net_from_json
from gspn_framework_package.formats.plan_parts import JsonObject, PlanParts, read_parts
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import InputError, RefusedError
from gspn_framework_package.model.net import Point
from gspn_framework_package.visualizer.documents import Folder, check_size
from gspn_framework_package.visualizer.layout import NEAREST, below, lay_out, nearest_distance

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
    return Opened(name, parts, document, etag, laid_out, scale_of(net))


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

    Positions of the file are kept as they are. If it has some, the nodes without one are put below
    the others; if it has none, or has all nodes in one spot, the net is laid out.
    """
    nodes = [*net["places"], *net["transitions"]]
    known = {n["name"]: n["position"] for n in nodes if n.get("position") is not None}
    spots = {tuple(point) for point in known.values()}
    if nodes and (not known or len(spots) == 1 < len(nodes)):
        return _placed(net, lay_out(net_from_json(net)).positions, True), True
    missing = [n["name"] for n in nodes if n["name"] not in known]
    found = [(float(x), float(y)) for x, y in known.values()]
    return _placed(net, below(found, missing), False), False


def _placed(net: JsonObject, positions: Dict[str, Point], anew: bool) -> JsonObject:
    def placed(node: JsonObject) -> JsonObject:
        if node["name"] not in positions or (node.get("position") is not None and not anew):
            return node
        x, y = positions[node["name"]]
        return {**node, "position": [round(x, 1), round(y, 1)]}

    return with_nodes(net, placed)


def with_nodes(net: JsonObject, change: Callable[[JsonObject], JsonObject]) -> JsonObject:
    """The net with each of its nodes changed."""
    return {
        **net,
        **{key: [change(node) for node in net[key]] for key in ("places", "transitions")},
    }


def scale_of(net: JsonObject) -> float:
    """The factor by which the page enlarges the net so that the two nearest nodes do not touch."""
    nodes = [*net["places"], *net["transitions"]]
    nearest = nearest_distance([(float(n["position"][0]), float(n["position"][1])) for n in nodes])
    if not 1e-6 < nearest < math.inf:
        return 1.0
    return min(max(0.3, NEAREST / nearest), 8.0)
