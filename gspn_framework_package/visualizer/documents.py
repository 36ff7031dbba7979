"""The documents that can be opened: files of the served folder, and uploads from a browser.

Only a plan of the served folder can be executed. An upload can only be shown and simulated.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import json
import os
import re
import tempfile
from typing import Dict, List, Mapping, NamedTuple, Optional, Tuple

from gspn_framework_package.analysis.plan.run_net_export import run_net_of
from gspn_framework_package.formats.plan_file import PLAN_FILE, looks_like_plan, read_net_or_plan
from gspn_framework_package.formats.registry import FORMATS
from gspn_framework_package.formats.source import is_inside
from gspn_framework_package.formats.thesis_input import is_thesis_input
from gspn_framework_package.model.errors import InputError, LimitError, RefusedError, UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

LOG_ENDINGS = (".jsonl", ".bag")

FILES_LISTED = 500
FOLDERS_DEEP = 4
MOST_DRAWN_NODES = 20_000
ARCS = 100_000
UPLOAD_FILES = 10

PROGRAMS = (".py", ".pyc", ".pth", ".so")
"""File extensions left out of an upload, which is shown but never run."""


class Document(NamedTuple):
    """An open net: ``title`` for people, ``plan`` if it is a plan, ``executable`` if the operator
    served it as a plan, ``notes`` on how it was read, ``file``: the plan file that the operator
    chose, next to which other plans may be saved ("" if there is none), ``meanings``: what the
    nodes of a run net stand for, by name."""

    title: str
    net: Net
    plan: Optional[Plan] = None
    executable: bool = False
    notes: Tuple[str, ...] = ()
    file: str = ""
    meanings: Mapping[str, str] = {}


class FileEntry(NamedTuple):
    """A file of the served folder: ``path`` relative to the folder, ``kind`` net, plan or log."""

    path: str
    kind: str
    size: int


class Folder:
    """The served folder. Nothing outside it is opened, not even through a link.

    :raises InputError: it is not a folder.
    """

    def __init__(self, root: str) -> None:
        self.root = os.path.realpath(root)
        if not os.path.isdir(self.root):
            raise InputError("there is no such folder", file=root)

    def entries(self) -> List[FileEntry]:
        """The nets, plans and logs in the folder, at most :data:`FILES_LISTED`."""
        found: List[FileEntry] = []
        for path, folders, names in os.walk(self.root):
            depth = os.path.relpath(path, self.root).count(os.sep) + 1
            folders[:] = sorted(
                f for f in folders if not f.startswith((".", "_")) and depth < FOLDERS_DEEP
            )
            for name in sorted(names):
                whole = os.path.join(path, name)
                with contextlib.suppress(OSError):  # deleted meanwhile
                    kind = self._kind(whole)
                    if kind and self._inside(whole):
                        found.append(
                            FileEntry(
                                os.path.relpath(whole, self.root), kind, os.path.getsize(whole)
                            )
                        )
            if len(found) >= FILES_LISTED:
                break
        return found[:FILES_LISTED]

    def resolve(self, path: str) -> str:
        """The absolute path of ``path``, which is relative to the folder.

        :raises RefusedError: it leads out of the folder.
        :raises InputError: it does not exist.
        """
        if "\0" in path or os.path.isabs(path):
            raise RefusedError("only files of the served folder are opened")
        _check_text(path)
        whole = os.path.realpath(os.path.join(self.root, path))
        if not self._inside(whole):
            raise RefusedError("only files of the served folder are opened")
        if not os.path.exists(whole):
            raise InputError("there is no such file", file=path)
        if not os.path.isdir(whole) and not os.path.isfile(whole):
            raise InputError("neither a file nor a folder", file=path)
        return whole

    def name(self, path: str) -> str:
        """The canonical name of the file at ``path``: relative to the folder, with links resolved;
        for the folder of a plan, its plan file.

        :raises GspnError: as :meth:`resolve`.
        """
        whole = self.resolve(path)
        if os.path.isdir(whole) and os.path.isfile(os.path.join(whole, PLAN_FILE)):
            whole = self.resolve(os.path.join(path, PLAN_FILE))
        return os.path.relpath(whole, self.root)

    def inside(self, whole: str) -> Optional[str]:
        """Convert an absolute path to one relative to the folder; None if it is outside the
        folder."""
        return os.path.relpath(os.path.realpath(whole), self.root) if self._inside(whole) else None

    def kind(self, path: str) -> str:
        """The kind of a file: net, plan, log, or "" for anything else."""
        return self._kind(self.resolve(path))

    def open(self, path: str) -> Document:
        """The net or plan at ``path``. :raises GspnError: it cannot be read."""
        whole = self.resolve(path)
        found = read_net_or_plan(whole, net_will_do=True, within=self.root)
        is_plan = found.plan is not None
        file = whole if is_plan else ""
        return _checked(Document(path, found.net, found.plan, is_plan, found.notes, file))

    def _inside(self, whole: str) -> bool:
        return is_inside(whole, self.root)

    @staticmethod
    def _kind(whole: str) -> str:
        name = os.path.basename(whole).lower()
        if os.path.isdir(whole):
            return "plan" if os.path.isfile(os.path.join(whole, PLAN_FILE)) else ""
        if not os.path.isfile(whole):  # reading a pipe or a device would block
            return ""
        if name.endswith(LOG_ENDINGS):
            return "log"
        if name.endswith(".json"):
            return "plan" if name == PLAN_FILE or looks_like_plan(whole) else ""
        endings = tuple(ending for known in FORMATS.values() for ending in known.extensions)
        return "net" if name.endswith(endings) else ""


def _check_text(name: str) -> None:
    """Check a file name. :raises UsageError: it has a character that no file name can contain."""
    try:
        name.encode()
    except UnicodeEncodeError:
        raise UsageError("a file has no valid name") from None


def read_upload(files: object) -> Document:
    """Read the net or plan that a browser sent.

    The files are read in a temporary folder: the files that an uploaded plan names must be among
    those sent with it.

    :param files: ``[{"name": ..., "content": base64}, ...]``: a net, or an input file with its net.
    :raises GspnError: it is neither, is too large, or names files that were not sent.
    """
    sent = _sent_files(files)
    with tempfile.TemporaryDirectory(prefix="gspn_upload_") as folder:
        plans = [name for name in sent if name.lower().endswith(".json")]
        for name, data in sent.items():
            with open(os.path.join(folder, name), "wb") as out:
                out.write(_only_beside(name, data, sent) if name in plans else data)
        if len(plans) > 1:
            raise UsageError("more than one input file was sent")
        try:
            if not plans and len(sent) > 1:
                raise UsageError("several nets were sent, but no input file that selects one")
            name = plans[0] if plans else next(iter(sent))
            file = os.path.join(folder, name)
            found = read_net_or_plan(file, net_will_do=True, within=folder)
            return _checked(Document(name, found.net, found.plan, notes=found.notes))
        except InputError as error:
            if error.file:  # do not reveal the folder
                error.file = os.path.basename(error.file)
            raise


def run_net_document(document: Document) -> Document:
    """The run net of a plan, to be shown.

    :raises UsageError: the document is a net.
    :raises RefusedError: an ordinary net cannot express the plan, or would be too large.
    """
    if document.plan is None:
        raise UsageError("only a plan has a run net")
    literal, notes = run_net_of(document.plan)
    nodes = {**literal.places, **literal.transitions}
    meanings = {name: meaning.text for name, meaning in nodes.items()}
    title = "%s, its run net" % document.title
    return _checked(Document(title, literal.net, notes=tuple(notes), meanings=meanings))


def _sent_files(files: object) -> Dict[str, bytes]:
    if not isinstance(files, list) or not 1 <= len(files) <= UPLOAD_FILES:
        raise UsageError("send 1 to %d files" % UPLOAD_FILES)
    sent = {}
    for item in files:
        name = item.get("name") if isinstance(item, dict) else None
        if not isinstance(name, str) or not re.fullmatch(r"[^/\\\0]{1,120}", name):
            raise UsageError("a file has no valid name")
        _check_text(name)
        if name.strip(". ") == "" or len(name.encode()) > 200:
            raise UsageError("a file has no valid name")
        if name.lower().endswith(PROGRAMS):
            continue
        try:
            sent[name] = base64.b64decode(item.get("content", ""), validate=True)
        except (binascii.Error, TypeError, ValueError):
            raise UsageError("the file '%s' did not arrive completely" % name) from None
    if not sent:
        raise UsageError("neither a net nor a plan was sent")
    return sent


def _only_beside(name: str, data: bytes, sent: Dict[str, bytes]) -> bytes:
    """An uploaded input file, with every file name replaced by that of a file sent with it."""
    try:
        plan = json.loads(data)
    except (ValueError, RecursionError):
        return data  # the reader will report the error
    if not isinstance(plan, dict):
        return data

    def beside(value: object) -> object:
        if not isinstance(value, str):
            return value
        base = re.split(r"[/\\]", value)[-1]
        if base not in sent:
            raise InputError(
                "it names the file '%s', which was not sent" % base[:120],
                file=name,
                hint="select the input file together with its net",
            )
        return base

    if is_thesis_input(plan):
        plan["gspn"] = beside(plan.get("gspn"))
        if "project_path" in plan:
            plan["project_path"] = "."
    else:
        if isinstance(plan.get("net"), dict) and "file" in plan["net"]:
            plan["net"]["file"] = beside(plan["net"]["file"])
        else:
            plan["net"] = beside(plan.get("net"))
        if isinstance(plan.get("policy"), str):
            plan["policy"] = beside(plan["policy"])
        actions = plan.get("actions")
        for action in actions.values() if isinstance(actions, dict) else ():
            if isinstance(action, dict) and "plan" in action:
                action["plan"] = beside(action["plan"])
    return json.dumps(plan).encode()


def _checked(document: Document) -> Document:
    """Return the document if a browser can show it. :raises LimitError: it is too large."""
    net = document.net
    check_size(len(net.places) + len(net.transitions), len(net.arcs), document.title)
    return document


def check_size(nodes: int, arcs: int, file: Optional[str] = None) -> None:
    """Check that a browser can show a net of this size. :raises LimitError: it is too large."""
    if nodes > MOST_DRAWN_NODES or arcs > ARCS:
        raise LimitError(
            "a net of %d nodes and %d arcs is too large for the page" % (nodes, arcs),
            file=file,
            hint="up to %d nodes and %d arcs are shown" % (MOST_DRAWN_NODES, ARCS),
        )
