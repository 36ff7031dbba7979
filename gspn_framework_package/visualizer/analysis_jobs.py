"""The page's analyses, each in a separate process that can be killed, with limits on time, states
and memory."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import subprocess
import sys
import tempfile
import threading
import time
from collections import OrderedDict
from typing import Any, Dict, Optional, Sequence

from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.errors import InputError, LimitError, RefusedError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.optimise_form import request_in_form
from gspn_framework_package.visualizer.optimised import Optimised, proposed_name, save_beside

JOBS_AT_ONCE = 2
JOBS_KEPT = 20

POLICIES_KEPT = 4
"""How many of the latest computed policies are kept; each may take tens of megabytes."""

ANALYSIS_SECONDS = 120.0
"""Time limit of one analysis, in seconds, unless the page asks for less."""

OPTIMISE_SECONDS = 600.0
"""The same for the computation of a policy."""

MOST_STATES = 2_000_000
"""Largest limit on states that the page may ask for."""

_WORKER = ("-m", "gspn_framework_package.visualizer.analysis_worker")

ALL_TRANSITIONS = "all transitions"
"""The name of the sum over all transitions, in a prediction."""

ANALYSIS_QUESTIONS = (
    "structure",
    "timing",
    "policy",
    "reading",
    "at",
    "reach",
    "cover",
    "mean_time_to",
    "settling",
    "rewards",
    "simulate",
    "sweep",
    "predict",
    "exact",
    "decide",
    "optimise",
)


class _Job:
    def __init__(
        self, request: Dict[str, Any], seconds: float, document: Document, session: str
    ) -> None:
        self.document, self.session = document, session
        self.optimised: Optional[Optimised] = None
        self.started = time.monotonic()
        self.seconds = seconds
        self.state = "running"
        self.progress: Dict[str, Any] = {}
        self.result: Optional[Dict[str, Any]] = None
        self.error = ""
        self.ended = 0.0
        self._complaints = tempfile.TemporaryFile()  # noqa: SIM115  # a full pipe would block the process
        try:
            self._process = start_worker(_WORKER, self._complaints)
        except OSError:
            self._complaints.close()
            raise
        self._request = json.dumps(request).encode()
        self._timer = threading.Timer(seconds, self._time_over)
        self._timer.daemon = True
        self._timer.start()
        threading.Thread(target=self._follow, name="analysis", daemon=True).start()

    def _follow(self) -> None:
        """Read the output of the process, on a thread, until it ends. Any error ends the job."""
        process = self._process
        try:
            self._listen()
        except Exception as error:
            self.error = self.error or "its answer cannot be read (%s)" % type(error).__name__
            kill(process)
        code = process.wait()
        self._timer.cancel()
        self.ended = time.monotonic()
        with self._complaints as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 400))
            last = file.read().decode("utf-8", "replace").strip().splitlines()[-1:]
        if self.state == "running":
            if code and not self.error:
                self.error = "the analysis failed (%s)" % (
                    last[0]
                    if last
                    else "the process ended with exit code %d: too little memory?" % code
                )
            self.state = "failed" if self.error or code else "done"

    def _listen(self) -> None:
        process = self._process
        assert process.stdin and process.stdout
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(self._request)
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        with process.stdout as answers:
            for line in answers:
                try:
                    message = json.loads(line)
                except ValueError:
                    continue
                if "progress" in message:
                    self.progress = message["progress"]
                elif "plan" in message and self.document.plan is not None:
                    self.optimised = Optimised(
                        self.document.plan, message["plan"], message["changed"], message["same"]
                    )
                elif "part" in message:
                    self.result = {**(self.result or {}), **message["part"]}
                elif "error" in message:
                    self.error = str(message["error"])

    def _time_over(self) -> None:
        if self.state == "running":
            self.error = "not decided within %g s" % self.seconds
            self.state = "failed"
            kill(self._process)

    def kill(self) -> None:
        if self.state == "running":
            self.state = "cancelled"
        self._timer.cancel()
        kill(self._process)

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def to_json(self) -> Dict[str, Any]:
        return {
            "state": self.state,
            "seconds": round((self.ended or time.monotonic()) - self.started, 2),
            "progress": self.progress,
            "result": self.result,
            "error": self.error,
            "saves_as": (
                proposed_name(self.document.file)
                if self.optimised is not None and self.document.file
                else None
            ),
        }


class AnalysisJobs:
    """All analyses of one server."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._jobs: OrderedDict[str, _Job] = OrderedDict()

    def start(
        self,
        document: Document,
        marking: Sequence[int],
        fields: Dict[str, Any],
        session: str = "",
    ) -> str:
        """Start an analysis and return its key.

        :param marking: the current marking of the page, used if ``from`` is ``marking``.
        :param fields: the requested ``parts``, the ``limit`` on states, ``seconds``, and the
            parameters of the parts.
        :param session: the key of the open net, by which :meth:`latest` finds it.
        :raises LimitError: too many analyses are running.
        :raises FormError: fields of the form for a policy cannot be used.
        """
        limit = _bounded(fields, "limit", 100_000, 1, MOST_STATES)
        most = OPTIMISE_SECONDS if "optimise" in fields else ANALYSIS_SECONDS
        seconds = _bounded(fields, "seconds", 60.0, 0.1, most)
        if "optimise" in fields:
            if document.plan is None:
                raise UsageError("only a plan has a policy that can be computed; this is a net")
            request_in_form(fields["optimise"], document.plan)  # report what is wrong in it now
        request: Dict[str, Any] = {key: fields[key] for key in ANALYSIS_QUESTIONS if key in fields}
        request.update(limit=int(limit), seconds=seconds)
        if document.plan is not None:
            request["plan"] = plan_to_json(document.plan)
        request["net"] = net_to_json(document.net)
        if fields.get("from") == "marking":
            request["marking"] = list(marking)
        with self._lock:
            if sum(job.running for job in self._jobs.values()) >= JOBS_AT_ONCE:
                raise LimitError(
                    "%d analyses are running already" % JOBS_AT_ONCE, hint="cancel one or wait"
                )
            key = secrets.token_hex(6)
            self._jobs[key] = _Job(request, seconds, document, session)
            for old in list(self._jobs)[:-JOBS_KEPT]:
                if not self._jobs[old].running:
                    del self._jobs[old]
            policies = [job for job in self._jobs.values() if job.optimised is not None]
            for job in policies[:-POLICIES_KEPT]:
                job.optimised = None
        return key

    def report(self, key: str) -> Dict[str, Any]:
        """Return the progress of a job. :raises InputError: no job has that key."""
        return self._job(key).to_json()

    def cancel(self, key: str) -> None:
        """Kill a job. :raises InputError: no job has that key."""
        self._job(key).kill()

    def optimised(self, key: str) -> Optimised:
        """The policy computed by a job. :raises InputError: there is none."""
        found = self._job(key).optimised
        if found is None:
            raise InputError("that analysis has no policy (any more)")
        return found

    def plan_of(self, key: str) -> Plan:
        """The plan that a job was given. :raises InputError: there is no such job, or it was given
        a net."""
        plan = self._job(key).document.plan
        if plan is None:
            raise InputError("that is the analysis of a net and not of a plan")
        return plan

    def latest(self, session: str) -> Optional[str]:
        """The key of the latest job of an open net that has computed a policy, if there is one."""
        with self._lock:
            for key, job in reversed(self._jobs.items()):
                if job.session == session and job.optimised is not None and job.state == "done":
                    return key
        return None

    def save(self, key: str, name: object, overwrite: bool) -> str:
        """Write a plan with a computed policy next to the plan that was open.

        :returns: the path of the new file.
        :raises GspnError: there is no such policy, the plan is not a file of this server, or the
            file cannot be written; see
            :func:`~gspn_framework_package.visualizer.optimised.save_beside`.
        """
        found, file = self.optimised(key), self._job(key).document.file
        if not file:
            raise RefusedError("the plan is not a file of this server", hint="download the plan")
        return save_beside(file, name, found.text, overwrite)

    def _job(self, key: str) -> _Job:
        with self._lock:
            if key not in self._jobs:
                raise InputError("there is no such analysis (any more)")
            return self._jobs[key]

    def close(self) -> None:
        """Kill all jobs."""
        with self._lock:
            for job in self._jobs.values():
                job.kill()


def start_worker(words: Sequence[str], complaints: Any = None) -> subprocess.Popen[bytes]:
    """Start ``python WORDS...`` with pipes, so that it imports the package that this process runs.

    :param complaints: the file for what it writes to stderr.
    """
    root = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    paths = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
    single = {"OPENBLAS_NUM_THREADS": "1"}  # as in cli.main
    return subprocess.Popen(
        [sys.executable, *words],
        env={**single, **os.environ, "PYTHONPATH": paths},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=complaints,
    )


def kill(worker: subprocess.Popen[bytes]) -> None:
    """Kill a worker. In Python 3.8 this may raise if another thread has just waited for it."""
    with contextlib.suppress(ProcessLookupError):
        worker.kill()


def _bounded(fields: Dict[str, Any], key: str, default: float, low: float, high: float) -> float:
    value = fields.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise UsageError("'%s' must be a number from %g to %g" % (key, low, high))
    return value
