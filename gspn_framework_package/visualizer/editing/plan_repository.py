"""The editor's operations on the files of the served folder."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import threading
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional

from gspn_framework_package.analysis.plan.completion import complete
from gspn_framework_package.formats import pipe
from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.json_file import json_text
from gspn_framework_package.formats.net_equality import same_net
from gspn_framework_package.formats.net_json import net_from_json
from gspn_framework_package.formats.plan_file import PLAN_FILE, read_plan
from gspn_framework_package.formats.plan_parts import JsonObject
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.formats.xml_tree import parse_xml
from gspn_framework_package.making import templates
from gspn_framework_package.making.plan_folder import NET_FILE, POLICY_FILE
from gspn_framework_package.model.errors import GspnError, InputError, RefusedError, UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.editing.atomic import recover, write_all
from gspn_framework_package.visualizer.editing.drafts import Drafts
from gspn_framework_package.visualizer.editing.functions import (
    FunctionSource,
    is_source,
    read_function,
    write_function,
)
from gspn_framework_package.visualizer.editing.open_document import (
    Opened,
    open_document,
    with_positions,
)
from gspn_framework_package.visualizer.editing.plan_files import PlanFiles
from gspn_framework_package.visualizer.editing.saving import changes_of, document_in, unfinished
from gspn_framework_package.visualizer.editing.sharing import OutdatedError, SharedPlans

FEW_ROWS = 40
"""In a new plan, a policy with more rows gets its own file."""

EMPTY: JsonObject = {
    "plan": {"actions": {}},
    "net": {"places": [], "transitions": [], "arcs": []},
    "policy": None,
}


class ConflictError(RefusedError):
    """The files have changed since they were opened. ``theirs`` is their present content."""

    def __init__(self, theirs: Opened) -> None:
        super().__init__(
            "somebody has changed the plan since you opened it: nothing was saved",
            hint="compare your changes with theirs",
            file=theirs.path,
        )
        self.theirs = theirs


class Saved(NamedTuple):
    """A document after saving: its state on the disk, the files that were written, and notes."""

    opened: Opened
    written: List[str]
    notes: List[str]


class PlanRepository:
    """Gives the editor access to the served folder."""

    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self.drafts = Drafts(folder)
        self.shared = SharedPlans()
        self._lock = threading.Lock()
        self._locks: Dict[str, threading.Lock] = {}

    def open(self, path: str) -> Opened:
        """Open a plan or net for editing. A net alone is completed to a plan.

        :raises GspnError: it cannot be opened.
        """
        with self._lock_of(path):
            return self._open(path)

    def _lock_of(self, path: str) -> threading.Lock:
        """The lock of a plan's folder, so that reading or saving one plan does not block others."""
        folder = os.path.dirname(self._whole(path))
        with self._lock:
            return self._locks.setdefault(folder, threading.Lock())

    def _open(self, path: str) -> Opened:
        whole = self.folder.resolve(path)
        recover(self.folder, whole if os.path.isdir(whole) else os.path.dirname(whole))
        opened = open_document(self.folder, path)
        if opened.parts.plan_file and (opened.document["plan"] or not opened.parts.thesis):
            return opened
        completed = complete(net_from_json(opened.parts.net))
        document = dict(completed.document)
        document["net"] = with_positions(document["net"])[0]
        notes = (*opened.parts.notes, *completed.notes)
        return opened._replace(document=document, parts=opened.parts._replace(notes=notes))

    def read_only(self, opened: Opened) -> str:
        """Why the document cannot be saved in its place; "" if it can."""
        parts = opened.parts
        if not parts.plan_file:
            return "it is only a net; save it as a plan in its own folder"
        if parts.thesis:
            return "it is an input file of the thesis; save it as a plan in its own folder"
        for file in parts.files:
            if not os.access(os.path.dirname(file), os.W_OK | os.X_OK):
                return "the folder of %s is not writable" % os.path.basename(file)
        return ""

    def save(
        self, path: str, etag: object, document: object, version: object = None, page: object = None
    ) -> Saved:
        """Save a document to the files that it was opened from.

        :param etag: the hash of the files that it was opened from.
        :param version: the version that it is based on; without one, it must be edited by no other
            page.
        :param page: the page that saves.
        :raises ConflictError: the files have changed since.
        :raises OutdatedError: somebody has another draft of it.
        :raises GspnError: it cannot be saved; in this case, no file has changed.
        """
        new = document_in(document)
        if not isinstance(etag, str):
            raise UsageError("'etag' is missing")
        with self._lock_of(path):
            opened = self._opened_again(path)
            if opened.etag != etag:
                raise ConflictError(opened)
            reason = self.read_only(opened)
            if reason:
                raise RefusedError(reason, file=opened.path)
            if self.drafts.version(opened.path):
                self._check_latest(opened.path, version, page)
            changes = changes_of(opened, new)
            if changes.contents:
                place = os.path.dirname(opened.parts.plan_file)
                write_all(self.folder, place, changes.contents)
                opened = self._open(path)
            self.drafts.forget(opened.path)
            self.shared.changed(opened.path, opened.etag)
        return Saved(opened, [self._name(file) for file in changes.contents], changes.notes)

    def keep_draft(
        self,
        path: str,
        etag: object,
        document: object,
        version: object = None,
        page: object = None,
        history: object = None,
    ) -> str:
        """Store or delete unsaved work.

        :param document: the document, which may be unfinished; None to delete the draft, which is
            kept if another page edits the plan, or has changed it since.
        :param version: the version that the document is based on; without one, no other page may
            edit the plan.
        :param page: the page that sends it.
        :param history: the edits that led to the document, as the page reads them again.
        :returns: the version of the draft; "" if there is none now.
        :raises OutdatedError: somebody has changed the plan since that version.
        :raises GspnError: it cannot be stored.
        """
        name = self._name(self._whole(path))
        with self._lock_of(path), self._lock:
            now = self.drafts.version(name)
            if document is None:
                others = self.shared.others(name, page)
                if now and (others or version not in (None, now)):
                    return now
                self.drafts.forget(name)
                if now:
                    self.shared.changed(name, self._files_version(name))
                return ""
            kept = unfinished(document)
            if not isinstance(etag, str) or len(etag) > 200:
                raise UsageError("'etag' is missing")
            self._check_latest(name, version, page)
            made = self.drafts.keep(name, etag, kept, _history(history))
            self.shared.changed(name, made)
            return made

    def _check_latest(self, path: str, version: object, page: object) -> None:
        """Check that a sent state is based on the latest one. :raises OutdatedError: it is not."""
        if version is None and not self.shared.others(path, page):
            return
        now = self.drafts.version(path) or self._files_version(path)
        if now and version != now:
            raise OutdatedError(self._latest(path))

    def _files_version(self, path: str) -> str:
        """The version of a plan without a draft: the hash of its files; "" if there are none."""
        try:
            return open_document(self.folder, path).etag
        except GspnError:
            return ""

    def latest(self, path: str) -> Dict[str, Any]:
        """The state that all pages of a plan share: its draft or, without one, its files, with
        their hash as ``etag``; its ``version``; and whether it is a ``draft``.

        :raises GspnError: it cannot be opened.
        """
        with self._lock_of(path):
            return self._latest(path)

    def _latest(self, path: str) -> Dict[str, Any]:
        opened = self._open(path)
        draft = self.drafts.of(opened.path, opened.etag)
        if draft is None:
            state = {"version": opened.etag, "etag": opened.etag, "document": opened.document}
            return {**state, "draft": False}
        return {**{key: draft[key] for key in ("version", "etag", "document")}, "draft": True}

    def function(self, path: str, name: object) -> FunctionSource:
        """Read a function of a plan. :raises GspnError: see :func:`read_function`."""
        with self._lock_of(path):
            return read_function(self._place_of_functions(path), name)

    def write_function(
        self, path: str, name: object, text: object, version: object
    ) -> FunctionSource:
        """Write a function of a plan. :raises GspnError: see :func:`write_function`."""
        with self._lock_of(path), self._lock:
            place = self._place_of_functions(path)
            return write_function(self.folder, place, name, text, version)

    def _place_of_functions(self, path: str) -> str:
        opened = self._open(path)
        reason = self.read_only(opened)
        if reason:
            raise RefusedError(reason, file=opened.path)
        return os.path.dirname(opened.parts.plan_file)

    def come(self, path: str, page: object, fields: Dict[str, Any], stream: bool = False) -> str:
        """Register a page that shows a plan; return its file. See :meth:`SharedPlans.come`."""
        with self._lock_of(path):
            name = self._name(self._whole(path))
            version = self.drafts.version(name) or self._files_version(name)
        self.shared.come(name, page, version, fields, stream)
        return name

    def leave(self, path: str, page: object) -> None:
        """A page has left a plan."""
        self.shared.leave(self._name(self._whole(path)), page, entirely=True)

    def _whole(self, path: str) -> str:
        """The absolute path of an open file, which may have been deleted since."""
        try:
            return self.folder.resolve(self.folder.name(path))
        except UsageError:
            raise
        except InputError:
            whole = os.path.realpath(os.path.join(self.folder.root, path))
            if self.folder.inside(whole) is None:
                raise
            return whole

    def _opened_again(self, path: str) -> Opened:
        try:
            return self._open(path)
        except GspnError as error:
            raise RefusedError(
                "the plan on disk cannot be opened any more, so nothing was saved: %s" % error,
                hint="save it as another plan",
            ) from None

    def _name(self, file: str) -> str:
        return os.path.relpath(file, self.folder.root)

    def save_as(self, path: str, document: object, name: object) -> str:
        """Save a document as a new plan in its own folder, with the functions and subnets that it
        uses.

        :param path: the file that it was opened from.
        :returns: the path of the new plan.
        :raises GspnError: it cannot be saved; in this case, no folder is created.
        """
        new = document_in(document)
        folder = self._new_name(name)
        whole = self._whole(path)

        def fill(made: str) -> None:
            contents = PlanFiles(self.folder, whole, new["plan"]).contents()
            _write(made, {**contents, **contents_of(new)})
            read_plan(made, self.folder.root)

        with self._lock_of(path):
            return self._make(folder, fill)

    def new(self, template: object, name: object) -> str:
        """Create a new plan from a template, or an empty one.

        :returns: the path of the new plan.
        :raises GspnError: there is no such template, or the mark cannot be written.
        """
        known = template_names()
        if not isinstance(template, str) or (template and template not in known):
            raise UsageError(
                "there is no such template", hint="the templates are %s" % ", ".join(known)
            )
        folder = self._new_name(name)

        def fill(made: str) -> None:
            if template:
                os.rmdir(made)
                templates.write(template, made, plan=folder)
            else:
                plan = {"plan": folder, **EMPTY["plan"]}
                _write(made, contents_of({**EMPTY, "plan": plan}))

        with self._lock:
            return self._make(folder, fill)

    def _new_name(self, name: object) -> str:
        if not isinstance(name, str) or not re.fullmatch(r"\w([\w .+-]{0,79}[\w+-])?", name):
            raise UsageError(
                "that is not a valid name of a folder",
                hint="letters, digits, '_', '-' and '.', at most 80",
            )
        self._check_free(name)
        return name

    def _check_free(self, name: str) -> None:
        if os.path.lexists(os.path.join(self.folder.root, name)):
            raise RefusedError("it exists already", hint="choose another name", file=name)

    def _make(self, name: str, fill: Callable[[str], None]) -> str:
        """Make the folder of a new plan, completely or not at all; return the path of the plan.

        :param fill: writes the files into an empty folder.
        """
        made = os.path.join(self.folder.root, ".gspn_new_" + secrets.token_hex(6))
        try:
            os.mkdir(made)
        except OSError as error:
            raise InputError("cannot create it: %s" % error.strerror, file=name) from None
        try:
            fill(made)
            self._check_free(name)
            os.rename(made, os.path.join(self.folder.root, name))
        except BaseException as error:
            shutil.rmtree(made, ignore_errors=True)
            if isinstance(error, OSError):
                raise InputError("cannot write it: %s" % error.strerror, file=name) from None
            if isinstance(error, GspnError) and error.file:
                error.file = error.file.replace(made, name)
            raise
        return os.path.join(name, PLAN_FILE)

    def everything_of(self, path: str, document: object) -> Dict[str, bytes]:
        """The plan as a folder, as it would be if the document were saved: the content of each
        file, by its path in the folder.

        :raises GspnError: a file cannot be read.
        """
        new = document_in(document)
        opened = self.open(path)
        whole = self.folder.resolve(opened.path)
        files = PlanFiles(self.folder, whole, new["plan"])
        contents = files.contents()
        parts = opened.parts
        if not parts.plan_file or parts.thesis:
            contents.update(contents_of(new))
        else:
            changed = changes_of(opened, new).contents
            place = os.path.dirname(parts.plan_file)
            inner = {file: os.path.relpath(file, place) for file in parts.files}
            beside = {file: name for file, name in inner.items() if not name.startswith(os.pardir)}
            for file, name in beside.items():
                contents[name] = changed.get(file) or read_bytes(file)
            if len(beside) < len(inner):
                contents.update(contents_of(new))
        return contents


def _history(sent: object) -> Optional[JsonObject]:
    """The history of a draft. :raises UsageError: it is malformed."""
    if sent is None:
        return None
    if not isinstance(sent, dict) or not all(
        isinstance(sent.get(key), list) for key in ("done", "undone")
    ):
        raise UsageError("'history' does not list edits")
    sources = sent.get("sources", {})
    if not isinstance(sources, dict) or not all(map(is_source, sources.values())):
        raise UsageError("'sources' are not those of functions")
    return {"done": sent["done"], "undone": sent["undone"], "sources": sources}


def template_names() -> List[str]:
    """The names of the templates of new plans."""
    return list(templates.templates_by_name())


def contents_of(document: JsonObject) -> Dict[str, bytes]:
    """The files of a new plan, by name; the net is in PIPE XML if that can represent it."""
    plan, net, policy = (document[key] for key in ("plan", "net", "policy"))
    contents: Dict[str, bytes] = {}
    first = {key: plan[key] for key in ("$schema", "plan", "description") if key in plan}
    drawn = _in_pipe(net)
    if drawn is not None:
        contents[NET_FILE] = drawn
    whole: JsonObject = {**first, "net": net if drawn is None else NET_FILE}
    if policy is not None:
        many = len(policy["rows"]) > FEW_ROWS
        whole["policy"] = POLICY_FILE if many else policy
        if many:
            contents[POLICY_FILE] = json_text(policy).encode()
    whole.update((key, value) for key, value in plan.items() if key not in whole)
    contents[PLAN_FILE] = json_text(whole).encode()
    return contents


def _in_pipe(data: JsonObject) -> Optional[bytes]:
    """The net as a PIPE file; None if PIPE cannot represent it."""
    try:
        net: Net = net_from_json(data)
        drawn = pipe.to_bytes(net)
        read = pipe.from_xml(parse_xml(drawn), None, ReadOptions())[0]
    except GspnError:
        return None
    return drawn if same_net(read, net) else None


def _write(folder: str, contents: Mapping[str, bytes]) -> None:
    """Write files into a folder: path in it -> content."""
    for name, data in contents.items():
        path = os.path.join(folder, name)
        os.makedirs(os.path.dirname(path), exist_ok=True)
        with open(path, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
