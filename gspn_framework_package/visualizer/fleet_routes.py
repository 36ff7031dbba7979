"""The routes of ``/api/history``: a fleet's history for the page."""

from __future__ import annotations

from typing import Any, Dict

import flask

from gspn_framework_package.model.errors import InputError
from gspn_framework_package.visualizer.fleet_page import FleetPage
from gspn_framework_package.visualizer.project import Project


def add_routes(app: flask.Flask, project: Project) -> None:
    """Add the routes."""

    def fleet() -> FleetPage:
        if project.fleet is None:
            raise InputError("this server shows no history", hint="gspn serve --history DIR")
        return project.fleet

    @app.route("/api/history/names")
    def names_in_history() -> Dict[str, Any]:
        return fleet().names()

    @app.route("/api/history/report")
    def report_on_history() -> Dict[str, Any]:
        return fleet().report(flask.request.args)

    @app.route("/api/history/moments")
    def moments_of_history() -> Dict[str, Any]:
        return fleet().moments(flask.request.args)
