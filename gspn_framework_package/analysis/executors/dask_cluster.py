"""Workers of a Dask cluster: https://distributed.dask.org."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import warnings
from typing import Any, Dict, Sequence

from gspn_framework_package.analysis.executors.remote import (
    Packed,
    RemoteExecutor,
    cancel_work,
    different_versions,
    version_difference,
    versions,
    work_on,
)
from gspn_framework_package.model.errors import WorkersError

_PATIENCE = 10.0
"""Seconds for a scheduler to answer, and for the first worker to appear."""

_UNANSWERED = (OSError, asyncio.TimeoutError, concurrent.futures.TimeoutError)


class DaskExecutor(RemoteExecutor):
    """The workers of the scheduler at an address, such as ``tcp://host:8786``.

    If a worker dies, Dask computes its tasks again on another one.

    :raises WorkersError: Dask is not installed, the address does not answer, there are no workers,
        or their versions differ from those of this process.
    """

    def __init__(self, address: str) -> None:
        try:
            import distributed
            from distributed.scheduler import KilledWorker
        except ImportError:
            raise WorkersError(
                "Dask is not installed", hint='pip install "dask[distributed]"'
            ) from None
        self.name = "dask:" + address
        self._address = address
        self._died_again: Any = KilledWorker
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # errors are raised here
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # versions are compared below
                client: Any = distributed.Client
                self._client: Any = client(address, timeout=_PATIENCE, set_as_default=False)
        except (*_UNANSWERED, ValueError, ImportError) as error:
            raise WorkersError(
                "no Dask scheduler answers at %s: %s" % (address, error or "timeout"),
                hint="start one with: dask scheduler",
            ) from None
        try:
            self._client.wait_for_workers(1, timeout=_PATIENCE)
            self._check_versions()
            self._pool = self._client.get_executor(pure=False)
        except BaseException as error:
            self._client.close()
            if isinstance(error, _UNANSWERED):
                raise WorkersError(
                    "the Dask scheduler at %s has no workers" % address,
                    hint="start some with: dask worker %s" % address,
                ) from None
            raise

    def _check_versions(self) -> None:
        try:
            found: Dict[str, Any] = self._client.run(versions)
        except Exception as error:
            raise WorkersError(
                "a worker of %s cannot load gspn_framework_package: %s" % (self.name, error),
                hint="install the same version of this package where the workers run",
            ) from None
        for address, theirs in sorted(found.items()):
            wrong = version_difference(theirs, versions())
            if wrong:
                raise different_versions("the worker %s" % address, wrong)

    @property
    def workers(self) -> int:
        """The present number of threads of all workers."""
        return max(sum(self._client.nthreads().values()), 1)

    def _submit(self, packed: Packed, piece: Any) -> Any:
        return self._pool.submit(work_on, packed, piece)

    def _result(self, future: Any) -> Any:
        try:
            return future.result()
        except self._died_again as error:
            raise WorkersError(
                "workers of %s died repeatedly on the same task: %s" % (self.name, error),
                hint="is there enough memory for them?",
            ) from None
        except concurrent.futures.CancelledError:
            raise self._lost() from None

    def _lost(self) -> WorkersError:
        return WorkersError("the Dask scheduler at %s no longer answers" % self._address)

    def _look(self) -> None:
        if self._client.status != "running":
            raise self._lost()

    def _stop(self, running: Sequence[Any], ticket: str) -> None:
        for future in running:
            future.cancel()
        if self._client.status == "running":
            self._client.run(cancel_work, ticket)

    def close(self) -> None:
        """Leave the cluster; its workers keep running."""
        self._client.close()
