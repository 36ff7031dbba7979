"""The warm processes that check edited documents for one server.

They have imported everything they need, so an answer takes only as long as the check itself. A new
request for a document cancels the previous one, which is answered at once. A process that does not
react to a cancellation or takes too long is killed and replaced.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import threading
import time
from typing import Any, Dict, List, Optional

from gspn_framework_package.execution.plan_modules import allowed_modules
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.visualizer import analysis_jobs

WORKERS = 2
"""How many documents are checked at once. While only one is, the other process is on standby."""

WORKER_PATIENCE = 1.0
"""Seconds after which a process that does not react to a cancellation is killed."""

START = 60.0
"""Seconds that a process has to start, on a busy machine."""

_WORKER = ("-m", "gspn_framework_package.visualizer.editing.check_worker")

_Answer = Dict[str, Any]


class _Request:
    def __init__(self, number: int, key: str) -> None:
        self.number, self.key = number, key
        self.answer: Optional[_Answer] = None
        self.cancelled = False


class _Worker:
    """A process, guarded by the lock of its pool."""

    def __init__(self) -> None:
        self.process = analysis_jobs.start_worker([*_WORKER, *allowed_modules()])
        self.request: Optional[_Request] = None
        self.given_up = 0.0
        """When its request was cancelled."""

    def say(self, message: Dict[str, Any]) -> bool:
        """Send it a message; return whether it was sent."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps(message).encode() + b"\n")
            self.process.stdin.flush()
        except OSError:
            return False
        return True


class CheckWorkers:
    """The processes of one server. None is started before it is needed (:meth:`warm`)."""

    def __init__(self) -> None:
        self._news = threading.Condition()
        self._workers: List[_Worker] = []
        self._newest: Dict[str, _Request] = {}
        self._numbers = itertools.count(1)
        self._closed = False

    def warm(self) -> None:
        """Start the processes, if that has not been done yet."""
        with self._news:
            while len(self._workers) < WORKERS and not self._closed:
                worker = _Worker()
                self._workers.append(worker)
                threading.Thread(
                    target=self._listen, args=(worker,), name="checks", daemon=True
                ).start()

    def ask(self, key: str, what: str, seconds: float, **fields: Any) -> _Answer:
        """Get the answer to a request.

        :param key: the subject: a newer request with the same key cancels this one.
        :param what: check, choices or running.
        :param seconds: how long it may take.
        :param fields: further fields of the request.
        :returns: ``{"answer": ...}``, ``{"cancelled": True}`` or ``{"error": message}``.
        :raises LimitError: all processes are busy.
        """
        with self._news:
            request = _Request(next(self._numbers), key)
            older = self._newest.get(key)
            self._newest[key] = request
            if older is not None:
                self._give_up(older)
        try:
            return self._ask(request, {"what": what, "seconds": seconds, **fields}, seconds)
        finally:
            with self._news:
                if self._newest.get(key) is request:
                    del self._newest[key]

    def _ask(self, request: _Request, fields: Dict[str, Any], seconds: float) -> _Answer:
        worker = self._take(request)
        if worker is None:
            return {"cancelled": True}
        sent = worker.say({"id": request.number, **fields})
        end = time.monotonic() + seconds + START
        with self._news:
            while sent and request.answer is None and not request.cancelled:
                left = end - time.monotonic()
                if left <= 0 or worker not in self._workers:
                    break
                self._news.wait(left)
            if request.cancelled:
                return {"cancelled": True}
            if request.answer is not None:
                return request.answer
            self._kill(worker)
        self.warm()
        return {"error": "the check ended without an answer: too little memory, or too much time?"}

    def _take(self, request: _Request) -> Optional[_Worker]:
        """Wait for a process without a request; None if this one is cancelled meanwhile."""
        end = time.monotonic() + START
        while True:
            self.warm()
            with self._news:
                if request.cancelled or self._closed:
                    return None
                for worker in self._workers:
                    if worker.request is None:
                        worker.request = request
                        return worker
                now = time.monotonic()
                for worker in list(self._workers):
                    if worker.given_up and now - worker.given_up > WORKER_PATIENCE:
                        self._kill(worker)
                        break
                else:
                    if now > end:
                        raise LimitError("too many plans are being checked", hint="try again")
                    self._news.wait(WORKER_PATIENCE / 4)

    def _give_up(self, request: _Request) -> None:
        request.cancelled = True
        for worker in self._workers:
            if worker.request is request:
                worker.given_up = time.monotonic()
                worker.say({"cancel": request.number})
        self._news.notify_all()

    def _kill(self, worker: _Worker) -> None:
        analysis_jobs.kill(worker.process)
        if worker in self._workers:
            self._workers.remove(worker)
        self._news.notify_all()

    def _listen(self, worker: _Worker) -> None:
        """Read the answers of a process, on a thread, until it ends."""
        process = worker.process
        assert process.stdin is not None and process.stdout is not None
        with process.stdout as lines:
            for line in lines:
                message = json.loads(line)
                with self._news:
                    request = worker.request
                    if request is not None and message.get("id") == request.number:
                        request.answer = {k: v for k, v in message.items() if k != "id"}
                        worker.request, worker.given_up = None, 0.0
                        self._news.notify_all()
        process.wait()
        with self._news:
            self._kill(worker)
        with contextlib.suppress(OSError):  # some input had not been written
            process.stdin.close()

    def close(self) -> None:
        """End all processes."""
        with self._news:
            self._closed = True
            for worker in list(self._workers):
                self._kill(worker)
