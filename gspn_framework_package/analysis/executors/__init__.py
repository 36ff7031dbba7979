"""Where long work is computed: in this process, in processes of this machine, or on a Dask cluster.

The result does not depend on it: work is cut into the same tasks everywhere, each task draws random
numbers of its own, and whoever asked adds the results up in the order of the tasks.

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
