"""Executors for long computations: in this process, in processes of this machine, or on a Dask
cluster.

The result does not depend on the executor: work is divided into the same tasks everywhere, each
task has its own random numbers, and the caller adds up the results in the order of the tasks.

Modules: ``choosing``, ``dask_cluster``, ``executor``, ``processes``, ``remote``.
"""

from gspn_framework_package.analysis.executors.choosing import EXECUTOR_FORMS, open_executor
from gspn_framework_package.analysis.executors.executor import (
    Executor,
    LocalExecutor,
    WorkItem,
    Workload,
)

__all__ = ["EXECUTOR_FORMS", "Executor", "LocalExecutor", "WorkItem", "Workload", "open_executor"]
