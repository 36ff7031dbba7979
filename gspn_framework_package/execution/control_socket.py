"""The control socket of a run without ROS: another process of the same user can ask the run to
switch to another plan.

Each run listens on a Unix socket in a folder that only its user may enter. A connection carries one
request and one answer, each a JSON object on a line. The socket of a process that was killed is
removed by the next search for runs.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import socket
import stat
import tempfile
import threading
from typing import Any, Callable, Dict, List, NamedTuple, Optional

from gspn_framework_package.model.errors import ExecutionError, GspnError

REQUEST_PATIENCE = 5.0
"""Seconds within which a line must arrive, and a run must identify itself."""

LARGEST_REQUEST = 10_000_000
"""Maximum size of a request or an answer, in bytes."""


class DeployRequest(NamedTuple):
    """A request to a run to switch to another plan.

    :ivar plan: absolute path of the plan file.
    :ivar mapping: name in the present net -> name in the new one.
    :ivar folder: folder of the functions; None for the plan's folder.
    :ivar wait: maximum number of seconds until the run follows the plan.
    """

    plan: str
    mapping: Dict[str, str]
    folder: Optional[str]
    wait: float


class RunningPlan(NamedTuple):
    """A run that accepts requests: its socket, its process, the name of its plan, and the files of
    its first and present plan."""

    socket: str
    process: int
    plan: str
    files: List[str]


class ControlSocket:
    """Lets other processes ask a run to switch to another plan.

    :param about: returns the name of the present plan and the files of the plans, as in
        :class:`RunningPlan`; called on any thread.
    :param deploy: carries out a request, or raises a :class:`GspnError` with the reason why not;
        called on a separate thread.
    :raises ExecutionError: the socket cannot be created.
    """

    def __init__(
        self, about: Callable[[], Dict[str, Any]], deploy: Callable[[DeployRequest], str]
    ) -> None:
        self._about, self._deploy = about, deploy
        self._path = os.path.join(_folder(), "%d-%s.sock" % (os.getpid(), secrets.token_hex(4)))
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.bind(self._path)
            self._socket.listen(8)
        except OSError as error:
            self._socket.close()
            raise ExecutionError("cannot listen (%s)" % error, file=self._path) from None
        threading.Thread(target=self._accept, name="door", daemon=True).start()

    def close(self) -> None:
        """Accept no more requests. Accepted ones are still answered."""
        with contextlib.suppress(OSError):
            os.unlink(self._path)
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # interrupts accept(), which close() does not
        self._socket.close()

    def __enter__(self) -> ControlSocket:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            threading.Thread(
                target=self._serve, args=(connection,), name="visitor", daemon=True
            ).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError):
            try:
                answer = self._answer(_receive(connection, REQUEST_PATIENCE))
            except GspnError as error:
                answer = {"done": False, "message": str(error)}
            except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
                answer = {"done": False, "message": "not a request (%r)" % error}
            _send(connection, answer)

    def _answer(self, request: Dict[str, Any]) -> Dict[str, Any]:
        if request["ask"] == "about":
            return self._about()
        if request["ask"] != "deploy":
            raise ValueError(request["ask"])
        mapping = {str(old): str(new) for old, new in request["mapping"].items()}
        folder = request["folder"]
        wanted = DeployRequest(
            str(request["plan"]),
            mapping,
            folder if folder is None else str(folder),
            float(request["wait"]),
        )
        return {"done": True, "message": self._deploy(wanted)}


def running_plans() -> List[RunningPlan]:
    """The runs of this user on this machine, by process id.

    :raises ExecutionError: their folder is not safe.
    """
    found = []
    folder = _folder()
    for name in os.listdir(folder):
        process = name.partition("-")[0]
        if not name.endswith(".sock") or not process.isdigit():
            continue
        path = os.path.join(folder, name)
        try:
            about = _ask(path, {"ask": "about"}, REQUEST_PATIENCE)
            files = [str(file) for file in about["files"]]
            found.append(RunningPlan(path, int(process), str(about["plan"]), files))
        except ConnectionRefusedError:  # the process was killed
            with contextlib.suppress(OSError):
                os.unlink(path)
        except (OSError, KeyError, TypeError, ValueError):
            continue  # the run is about to end, or does not answer
    return sorted(found, key=lambda run: run.process)


def ask_to_deploy(run: RunningPlan, request: DeployRequest) -> Dict[str, Any]:
    """Ask a run to switch to another plan. Returns ``done``, whether it did, and a ``message``.

    :raises ExecutionError: the run does not answer, so it is unknown whether it follows the plan.
    """
    try:
        question = {"ask": "deploy", **request._asdict()}
        answer = _ask(run.socket, question, request.wait + 4 * REQUEST_PATIENCE)
        return {"done": bool(answer["done"]), "message": str(answer["message"])}
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ExecutionError(
            "process %d does not answer (%s)" % (run.process, error),
            hint="see its output for whether it follows the new plan",
        ) from None


def chosen_run(runs: List[RunningPlan], file: str, process: str) -> RunningPlan:
    """Choose the run that is meant.

    :param file: its present or first plan; "" for any.
    :param process: its process id; "" if there is only one run.
    :raises ExecutionError: no run matches, or several do.
    """
    fitting = [run for run in runs if not file or os.path.realpath(file) in run.files]
    if process:
        fitting = [run for run in fitting if str(run.process) == process]
    if not fitting:
        raise ExecutionError(
            "no run found%s%s"
            % (" of %s" % file if file else "", " in process %s" % process if process else ""),
            hint="; ".join(_in_words(run) for run in runs) or "start one with gspn run",
        )
    if len(fitting) > 1:
        raise ExecutionError(
            "there are several runs: %s" % "; ".join(_in_words(run) for run in fitting),
            hint="choose one with --run PROCESS",
        )
    return fitting[0]


def _in_words(run: RunningPlan) -> str:
    return "process %d runs %s" % (run.process, run.files[-1] if run.files else run.plan)


def _folder() -> str:
    """The folder of the sockets, which only the user may access.

    :raises ExecutionError: the folder cannot be created, or others may access it.
    """
    own = os.environ.get("XDG_RUNTIME_DIR", "")
    if own and os.path.isdir(own):
        path = os.path.join(own, "gspn_runs")
    else:
        path = os.path.join(tempfile.gettempdir(), "gspn_runs_%d" % os.geteuid())
    try:
        with contextlib.suppress(FileExistsError):
            os.mkdir(path, 0o700)
        found = os.lstat(path)
    except OSError as error:
        raise ExecutionError("cannot be created (%s)" % error.strerror, file=path) from None
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & 0o077:
        raise ExecutionError(
            "is not a folder that only you may access", file=path, hint="remove it, or chmod 700"
        )
    return path


def _ask(path: str, request: Dict[str, Any], patience: float) -> Dict[str, Any]:
    """:raises OSError, ValueError: there is no answer."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(REQUEST_PATIENCE)
        connection.connect(path)
        _send(connection, request)
        return _receive(connection, patience)


def _send(connection: socket.socket, data: Dict[str, Any]) -> None:
    connection.sendall(json.dumps(data).encode() + b"\n")


def _receive(connection: socket.socket, patience: float) -> Dict[str, Any]:
    """The JSON object on a line. :raises OSError, ValueError: none arrived in time."""
    connection.settimeout(patience)
    data = b""
    while not data.endswith(b"\n"):
        part = connection.recv(65_536)
        if not part:
            raise ValueError("the connection ended")
        data += part
        if len(data) > LARGEST_REQUEST:
            raise ValueError("the line is too long")
    found = json.loads(data.decode())
    if not isinstance(found, dict):
        raise ValueError("not a JSON object")
    return found
