"""The story of the run that an open net shows, for the page: as JSON, and as a file to send."""

from __future__ import annotations

import os
import re
import threading
from typing import Any, Dict
from urllib.parse import quote

import flask
from flask import Response, request

from gspn_framework_package.fleet.run_story import RunStory, read_story, story_to_json
from gspn_framework_package.fleet.story_page import story_page
from gspn_framework_package.model.errors import GspnError, InputError
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.session import Session

STORY_BYTES = 100_000_000
"""Size of the largest log whose story the page shows; it is read while a viewer waits."""

_MOST = 200
"""Largest numbers of waits and moments on the page."""


class RunStories:
    """Reads stories, one at a time, and keeps the latest."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._read = "", 0
        self._story: Any = None

    def of(self, session: Session) -> RunStory:
        """The story of the run shown, up to now if the run continues.

        :raises InputError: this server has no log of it, or a log that is too large.
        """
        path = session.activity.log
        if not path:
            raise InputError(
                "this server has no log of a run",
                hint="open a recorded run, or start this plan on this server with recording",
            )
        size = os.path.getsize(path)
        if size > STORY_BYTES:
            raise InputError(
                "the log has %d MB; the page reads up to %d MB"
                % (size // 1_000_000, STORY_BYTES // 1_000_000),
                hint="gspn report reads longer logs",
            )
        with self._lock:
            if self._read != (path, size):
                try:
                    self._story = read_story(path)
                except GspnError as error:
                    error.file = os.path.basename(path)  # viewers need not know the folders
                    raise
                self._read = path, size
            return self._story


def add_routes(app: flask.Flask, project: Project) -> None:
    """Add the routes of stories."""
    stories = RunStories()

    def shown() -> Session:
        return project.session(request.args.get("id", ""))

    @app.route("/api/story")
    def story() -> Dict[str, Any]:
        return story_to_json(stories.of(shown()), _MOST)

    @app.route("/api/report")
    def report() -> Response:
        session = shown()
        found = stories.of(session)
        name = os.path.basename(session.activity.log or "")
        link = "%s#%s" % (request.host_url, quote(session.key, safe=""))
        # slots are found in recorded runs only
        page = story_page(found, name, link if session.activity.mode == "REPLAY" else "")
        response = Response(page, mimetype="text/html")
        stem = re.sub("[^A-Za-z0-9._-]+", "_", found.run)
        response.headers["Content-Disposition"] = "attachment; filename=%s.html" % stem
        return response
