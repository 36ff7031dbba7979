"""The page's checks and analyses in processes that are forked from one that has imported what they
need: see :mod:`forked`."""

import importlib.util
import os
from unittest import mock

from forked import ForkServer

from gspn_framework_package.visualizer import analysis_jobs

_SERVER = ForkServer(
    "gspn_framework_package.visualizer.analysis_worker",
    "gspn_framework_package.visualizer.editing.check_worker",
    "gspn_framework_package.analysis.decisions.optimise",
    "gspn_framework_package.analysis.monitoring.prediction",
    "gspn_framework_package.analysis.preflight",
    "gspn_framework_package.analysis.proofs.ladder",
    "gspn_framework_package.analysis.simulation",
    *(
        "gspn_framework_package.ros." + name
        for name in ("action_kinds", "event_sources")
        if importlib.util.find_spec("rospy")
    ),
)


def forked_workers():
    """A context in which the processes of pages are forked."""
    return mock.patch.object(analysis_jobs, "start_worker", _start)


def _start(words, stderr=None):
    (their_input, stdin), (stdout, their_output) = os.pipe(), os.pipe()
    process = _SERVER.start(
        list(words), [their_input, their_output, 2 if stderr is None else stderr.fileno()]
    )
    process.stdin, process.stdout = open(stdin, "wb"), open(stdout, "rb")  # noqa: SIM115
    os.close(their_input)
    os.close(their_output)
    return process
