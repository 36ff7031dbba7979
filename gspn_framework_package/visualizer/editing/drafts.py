"""Drafts: unsaved work, kept by the server outside the files of the plans."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import time
from typing import Any, Dict, Optional

from gspn_framework_package.formats.plan_parts import JsonObject
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import InputError, RefusedError
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.editing.atomic import write_all

DRAFTS = ".gspn_drafts"
"""The folder of the drafts, in the served folder."""

MOST_DRAFTS = 200
"""Largest number of drafts."""

LARGEST_DRAFT = 16_000_000
"""Largest draft, in bytes."""


class Drafts:
    """The drafts of one served folder, one for each file."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder
        self._place = os.path.join(folder.root, DRAFTS)

    def keep(
        self, path: str, etag: str, document: JsonObject, history: Optional[JsonObject] = None
    ) -> str:
        """Store a draft, replacing an earlier one; return its version.

        :param path: the file that is edited.
        :param etag: the hash of its files when it was opened.
        :param history: the edits that led to it, for the page.
        :raises GspnError: it cannot be stored.
        """
        draft = {
            "path": path,
            "etag": etag,
            "saved_at": time.time(),
            "version": secrets.token_hex(8),
            "document": document,
            "history": history,
        }
        data = json.dumps(draft, ensure_ascii=False, allow_nan=False).encode()
        if len(data) > LARGEST_DRAFT:
            raise InputError("the plan is too large for a draft: save it")
        if os.path.islink(self._place):
            raise RefusedError("%s is a link: drafts are not stored there" % DRAFTS)
        file = self._file(path)
        try:
            os.makedirs(self._place, mode=0o700, exist_ok=True)
            if not os.path.lexists(file) and len(os.listdir(self._place)) >= MOST_DRAFTS:
                self._make_room()
        except OSError as error:
            raise InputError(
                "the draft cannot be stored: %s" % error.strerror,
                file=DRAFTS,
                hint="save the plan, or download it, before you leave the page",
            ) from None
        if os.path.islink(file):
            raise RefusedError("the draft is a link: it is not written")
        write_all(self._folder, self._place, {file: data})
        return str(draft["version"])

    def _make_room(self) -> None:
        """Delete the drafts of files that no longer exist. :raises RefusedError: there are none."""
        for name in os.listdir(self._place):
            draft = self._read(os.path.join(self._place, name))
            if draft is None or not os.path.exists(
                os.path.join(self._folder.root, str(draft.get("path")))
            ):
                with contextlib.suppress(OSError):
                    os.unlink(os.path.join(self._place, name))
        if len(os.listdir(self._place)) >= MOST_DRAFTS:
            raise RefusedError(
                "there are %d drafts already" % MOST_DRAFTS,
                hint="save some, or delete some in %s" % DRAFTS,
            )

    def of(self, path: str, etag: str) -> Optional[Dict[str, Any]]:
        """The draft of a file: ``document``, the ``etag`` of the files it was based on, when it was
        ``saved_at`` (s since 1970), its ``version`` and ``history``, and whether the files
        have changed since (``outdated``)."""
        draft = self._read(self._file(path))
        if draft is None or draft.get("path") != path:
            return None
        found = {
            key: draft.get(key) for key in ("document", "etag", "saved_at", "version", "history")
        }
        return {**found, "outdated": draft.get("etag") != etag}

    def version(self, path: str) -> str:
        """The version of the draft of a file; "" if there is none."""
        draft = self._read(self._file(path))
        return str(draft["version"]) if draft and draft.get("path") == path else ""

    def forget(self, path: str) -> None:
        """Delete the draft of a file, if there is one."""
        with contextlib.suppress(OSError):
            os.unlink(self._file(path))

    def _file(self, path: str) -> str:
        digest = hashlib.sha256(path.encode(errors="surrogateescape")).hexdigest()
        return os.path.join(self._place, digest[:32] + ".json")

    def _read(self, file: str) -> Optional[Dict[str, Any]]:
        """The content of a draft; None if it is missing or cannot be read."""
        try:
            if os.path.islink(self._place) or os.path.islink(file) or not os.path.isfile(file):
                return None
            draft = json.loads(read_bytes(file, LARGEST_DRAFT))
        except (InputError, ValueError, RecursionError):
            return None
        if not isinstance(draft, dict) or not isinstance(draft.get("document"), dict):
            return None
        # a draft of an earlier release has no version: the time when it was stored names it
        return {"version": "of %s" % draft.get("saved_at"), **draft}
