"""The resources of ``gspn mcp``: what its client may read, each with an address. They are the
plans, nets and logs of the folder, and the documents of this package if they are installed."""

from __future__ import annotations

import os
from typing import Any, Dict, List
from urllib.parse import quote, unquote

from gspn_framework_package.formats.example_plans import share_folder
from gspn_framework_package.model.errors import InputError, LimitError
from gspn_framework_package.visualizer.documents import Folder

FILES, DOCUMENTS = "gspn://files/", "gspn://docs/"
"""Prefixes of the addresses of files and of documents."""

_MEDIA = {".json": "application/json", ".jsonl": "application/jsonl", ".md": "text/markdown"}
_BINARY = (".bag",)


def documents_folder() -> str:
    """The folder of the documents: beside this package in a checkout, or in its share folder where
    it is installed; "" if there are none."""
    package = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    share = share_folder()
    candidates = (os.path.join(os.path.dirname(package), "docs"), os.path.join(share, "docs"))
    return next((c for c in candidates if os.path.isfile(os.path.join(c, "plan_file.md"))), "")


class Resources:
    """The resources that may be read.

    :param folder: the folder of the plans.
    :param characters: maximum length of an answer.
    """

    def __init__(self, folder: str, characters: int) -> None:
        self._folder, self._characters = Folder(folder), characters
        self._documents = documents_folder()

    def listed(self) -> List[Dict[str, Any]]:
        """The resources, as the protocol describes them."""
        files = [
            {
                "uri": FILES + quote(entry.path),
                "name": entry.path,
                "description": "a %s of the folder" % entry.kind,
                "mimeType": _media_type(entry.path),
                "size": entry.size,
            }
            for entry in self._folder.entries()
            if not entry.path.endswith(_BINARY)
        ]
        documents = [
            {
                "uri": DOCUMENTS + name,
                "name": "docs/" + name,
                "description": _title(os.path.join(self._documents, name)),
                "mimeType": _media_type(name),
            }
            for name in self._document_names()
        ]
        return [*files, *documents]

    def read(self, uri: str) -> Dict[str, Any]:
        """The contents of a resource, as the protocol has them.

        :raises GspnError: there is no such resource, or it is too long.
        """
        whole = self._path(uri)
        most = self._characters
        with open(whole, encoding="utf-8", errors="replace") as file:
            text = file.read(most + 1)
        if len(text) > most:
            raise LimitError(
                "it has more than %d characters" % most,
                element=uri,
                hint="start the server with a higher --limit-output",
            )
        return {"contents": [{"uri": uri, "mimeType": _media_type(whole), "text": text}]}

    def _path(self, uri: str) -> str:
        """The file of a resource. :raises GspnError: there is no such resource."""
        if uri.startswith(DOCUMENTS) and uri[len(DOCUMENTS) :] in self._document_names():
            return os.path.join(self._documents, uri[len(DOCUMENTS) :])
        if uri.startswith(FILES):
            path = unquote(uri[len(FILES) :])
            if self._folder.kind(path) and not path.endswith(_BINARY):
                return self._folder.resolve(self._folder.name(path))
        raise InputError("there is no such resource", element=uri[:200])

    def _document_names(self) -> List[str]:
        names = os.listdir(self._documents) if self._documents else []
        return sorted(name for name in names if name.endswith(".md"))


def _media_type(path: str) -> str:
    return _MEDIA.get(os.path.splitext(path)[1], "text/plain")


def _title(path: str) -> str:
    """The heading of a document."""
    with open(path, encoding="utf-8") as file:
        return next((line[2:].strip() for line in file if line.startswith("# ")), "")
