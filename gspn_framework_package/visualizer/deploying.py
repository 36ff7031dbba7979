"""Deploying from the page: gives the run that a session shows another plan.

The plan is a file of the served folder, or one with a policy that was computed here. The operator
first sees what would change and maps names that no longer exist to new ones. Then the robots check
the plan; the page polls their progress.
"""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from typing import Any, Callable, Dict, List, Mapping, NamedTuple

import flask

from gspn_framework_package.analysis.preflight.report import PreflightReport, Severity
from gspn_framework_package.formats.difference import document_difference
from gspn_framework_package.formats.edited_document import document_from_json
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.model.errors import GspnError, InputError, RefusedError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.deploy_team import Votes
from gspn_framework_package.visualizer.activity import RequestFields, text_field
from gspn_framework_package.visualizer.analysis_jobs import AnalysisJobs
from gspn_framework_package.visualizer.editing.findings import LEVELS
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.session import Session


class PageDeploy(NamedTuple):
    """The state of the latest deployment into the run of a session: ``looking`` while the members
    examine the plan, then ``done`` or ``refused``; ``says`` gives the reason."""

    state: str
    plan: str
    says: str
    votes: Votes

    def to_json(self) -> Dict[str, Any]:
        """As a JSON object."""
        return {**self._asdict(), "votes": dict(self.votes)}


class PageDeploys:
    """The latest deployment of each session."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._latest: Dict[str, PageDeploy] = {}

    def latest(self, key: str) -> Dict[str, Any]:
        """The progress of the latest one, as a JSON object; without ``state`` if there was none."""
        with self._lock:
            found = self._latest.get(key)
        return found.to_json() if found is not None else {}

    def begin(self, session: Session, plan: Plan, fields: RequestFields) -> None:
        """Deploy a plan, on a thread.

        :param fields: ``map``: names of the present net -> their names in the plan; ``run``: the
            expected run.
        :raises GspnError: the fields are wrong, or a plan is being deployed already.
        """
        mapping = _mapping(fields)
        activity = session.activity_meant(fields)
        if "deploy" not in _offered(session):
            raise RefusedError(
                "there is no run here that could follow another plan", hint="start one first"
            )
        with self._lock:
            known = self._latest.get(session.key)
            if known is not None and known.state == "looking":
                raise RefusedError("a plan is being deployed already", hint="wait for that")
            self._latest[session.key] = PageDeploy("looking", plan.name, "", {})
        session.touched = True

        def tell(state: str, says: str, votes: Votes) -> None:
            with self._lock:
                self._latest[session.key] = PageDeploy(state, plan.name, says, votes)

        def work() -> None:
            try:
                outcome = activity.deploy(plan, mapping, lambda votes: tell("looking", "", votes))
                tell("done" if outcome.done else "refused", outcome.message, outcome.votes)
            except GspnError as error:
                tell("refused", str(error), {})
            except Exception as error:  # otherwise, the page would wait forever
                tell("refused", "internal error: %s" % type(error).__name__, {})
                raise

        threading.Thread(target=work, name="deploy", daemon=True).start()


def _mapping(fields: RequestFields) -> Dict[str, str]:
    found = fields.get("map", {})
    if not isinstance(found, dict) or not all(isinstance(v, str) for v in found.values()):
        raise UsageError("'map' must be an object: present name -> new name")
    return found


def proposal(old: Plan, new: Plan, report: PreflightReport) -> Dict[str, Any]:
    """The facts on which the operator decides.

    :param report: the check's report on the new plan.
    :returns: the ``verdict`` of the check, whether it is ``refused``, and its ``findings``; the
        ``changes``; the places and transitions that are ``gone``, each with its ``kind`` and
        whether its tokens can be dropped; and the names that may replace them, by kind.
    """
    before, after = (document_from_json(plan_to_json(plan)) for plan in (old, new))
    changes = document_difference(before, after, positions=False)
    places, transitions = _kinds(old), [t.name for t in old.net.transitions]
    there = {**_kinds(new), **{t.name: "transition" for t in new.net.transitions}}
    gone = [(name, kind) for name, kind in places.items() if name not in there]
    gone += [(name, "transition") for name in transitions if name not in there]
    known = {*places, *transitions}
    names: Dict[str, List[str]] = {}
    for name, kind in there.items():
        names.setdefault(kind, []).append(name)
    return {
        "present": old.name,
        "plan": new.name,
        "verdict": report.verdict,
        "refused": report.refused,
        "findings": [
            {"level": LEVELS[item.severity], "text": item.text}
            for item in report.items
            if item.severity is not Severity.OK
        ],
        "changes": [change.to_json() for change in changes],
        "gone": [{"name": name, "kind": kind} for name, kind in gone],
        # new names come first
        "names": {kind: sorted(found, key=lambda n: n in known) for kind, found in names.items()},
    }


def _kinds(plan: Plan) -> Dict[str, str]:
    return {
        p.name: "resource place" if p.name in plan.resource_places else "action place"
        for p in plan.net.places
    }


def add_routes(
    app: flask.Flask, project: Project, jobs: AnalysisJobs, body: Callable[[], Dict[str, Any]]
) -> None:
    """Add the routes of ``/api/deploy``.

    :param body: reads the JSON object of a request.
    """
    deploys = PageDeploys()

    def session() -> Session:
        return project.session(flask.request.args.get("id", ""))

    def plan_in(fields: Mapping[str, Any]) -> Plan:
        if "job" in fields:
            job = text_field(fields, "job")
            present = jobs.plan_of(job)
            data = json.loads(jobs.optimised(job).text)
            return replace(plan_from_json(data), folder=present.folder, file=present.file)
        if project.folder is None:
            raise RefusedError("no folder is served here")
        plan = project.folder.open(text_field(fields, "path")).plan
        if plan is None:
            raise InputError("that is a net and not a plan")
        return plan

    @app.route("/api/deploy/targets")
    def deploy_targets() -> Dict[str, Any]:
        found = [each for each in project.sessions.all() if "deploy" in _offered(each)]
        return {
            "runs": [
                {"id": each.key, "title": each.document.title, "run": each.hub.status().get("run")}
                for each in found
            ]
        }

    @app.route("/api/deploy/look", methods=["POST"])
    def deploy_look() -> Dict[str, Any]:
        shown = session()
        present = shown.document_at(shown.hub.board().plan).plan
        if present is None:
            raise InputError("the run is not one of a plan")
        plan = plan_in(body())
        return proposal(present, plan, shown.activity.verdict(plan))

    @app.route("/api/deploy", methods=["POST"])
    def deploy() -> Dict[str, Any]:
        fields = body()
        deploys.begin(session(), plan_in(fields), fields)
        return {}

    @app.route("/api/deploy")
    def deployment() -> Dict[str, Any]:
        found = deploys.latest(session().key)
        return {**found, "says": project.without_folders(found["says"])} if found else found


def _offered(session: Session) -> List[str]:
    """The orders that the run of a session accepts."""
    status = session.hub.status()
    going = status.get("running") and status.get("ended") is None
    return list(session.hub.info.get("commands", ())) if going else []
