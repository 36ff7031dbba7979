"""Reads worlds of Gazebo (SDF): the solid bodies of their models, as the boxes and cylinders of a
room.

Bodies that robots pass under or drive over are left out. All bodies stand still.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Dict, Iterator, List, Optional, Tuple

import numpy as np

from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.formats.xml_tree import (
    all_of,
    child,
    parse_xml,
    tag,
    text_of,
)
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.room import Obstacle
from gspn_framework_package.world.shapes import ShapePlace, pose_of, read_shape, resolve

if TYPE_CHECKING:
    from lxml import etree

_MOST_LEVELS = 10  # of models in models

_BUILT_IN = ("sun", "ground_plane")  # models that come with Gazebo and are not bodies of a room


def read_world(file: str) -> Tuple[List[Obstacle], List[str]]:
    """The solid bodies of a world, and notes on what was left out.

    :raises InputError: it is not an SDF world, or has a body that cannot be read; the first of
        these.
    """
    root = parse_xml(read_bytes(file), file)
    worlds = all_of(root, "world")
    if tag(root) != "sdf" or len(worlds) != 1:
        raise InputError("it is not an SDF file with one world", file=file)
    (world,) = worlds
    notes: List[str] = []
    solids: List[Obstacle] = []
    state = child(world, "state")
    moved = {} if state is None else {m.get("name", ""): m for m in all_of(state, "model")}
    place = ShapePlace(file, (), np.eye(4))
    for name in ("actor", "population", "road"):
        for element in all_of(world, name):
            raise place.error("<%s> is not read" % name, element, "remove it from the world")
    for model, there, static in _models(world, place, moved, 0):
        if not static:
            notes.append("%s can be pushed in Gazebo; here it stands still" % there.names[-1])
        solids += _read_model(model, there, notes)
    return solids, notes


def _models(
    parent: etree._Element, place: ShapePlace, moved: Dict[str, etree._Element], level: int
) -> Iterator[Tuple[etree._Element, ShapePlace, bool]]:
    """The models in an element, also those included from other files and those in models; and
    whether they are fixed in Gazebo, so that nothing can push them."""
    if level > _MOST_LEVELS:
        raise place.error("models include each other too deeply", parent)
    for element in parent:
        kind = tag(element)
        if element.get("placement_frame") or child(element, "placement_frame") is not None:
            raise place.error("a model with 'placement_frame' is not read", element)
        if kind == "include":
            found = _included(element, place)
            if found is None:
                continue
            model, path = found
            own = pose_of(element if child(element, "pose") is not None else model, place)
            name = text_of(element, "name") or model.get("name", "")
        elif kind == "model":
            model, path, name = element, place.file, element.get("name", "")
            own = pose_of(model, place)
        else:
            continue
        if name in moved:  # where Gazebo had it when the world was saved
            own = pose_of(moved[name], place)
        there = ShapePlace(path, (*place.names, "model '%s'" % name), place.pose @ own)
        static = text_of(element, "static") or text_of(model, "static") or "false"
        yield model, there, static in ("true", "1")
        yield from _models(model, there, {}, level + 1)


def _included(element: etree._Element, place: ShapePlace) -> Optional[Tuple[etree._Element, str]]:
    """The model that an ``<include>`` names, and its file; None if it is not a body of a room."""
    uri = text_of(element, "uri") or ""
    if uri.rpartition("/")[2] in _BUILT_IN:
        return None
    folder = resolve(uri, place, element)
    path = os.path.join(folder, "model.sdf") if os.path.isdir(folder) else folder
    root = parse_xml(read_bytes(path), path)
    model = child(root, "model")
    if tag(root) != "sdf" or model is None:
        raise InputError("it is not an SDF file with a model", file=path)
    return model, path


def _read_model(model: etree._Element, place: ShapePlace, notes: List[str]) -> List[Obstacle]:
    solids: List[Obstacle] = []
    for link in all_of(model, "link"):
        in_link = place.inner(link)
        for collision in all_of(link, "collision"):
            there = in_link.inner(collision)
            geometry = child(collision, "geometry")
            shapes = [] if geometry is None else [shape for shape in geometry if tag(shape)]
            if len(shapes) != 1:
                raise there.error("it must have exactly one geometry", collision)
            found = read_shape(shapes[0], there)
            if found is None:
                notes.append("%s: robots pass under or over it" % ", ".join(there.names))
            solids += found or []
    return solids
