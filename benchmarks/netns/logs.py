"""Checks the event logs of a team after its run.

The logs are files of one host, with one monotonic clock, so they can be read without using the
network.
"""

from __future__ import annotations

import itertools
import subprocess
import sys
from typing import Dict, List, NamedTuple, Sequence

from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.model.errors import ExecutionError


class AgreedHistory(NamedTuple):
    """The history that the logs agree on; ``marking`` is the last one, without empty places."""

    slots: int
    firings: int
    marking: Dict[str, int]


def check_history(paths: Sequence[str]) -> AgreedHistory:
    """Replay each log, compare all pairwise, slot by slot, and check the rules with ``gspn
    verify``.

    :raises ExecutionError: they contradict each other, or do not end at the same slot and
      marking.
    :raises LogError: a log contradicts itself.
    """
    hashes: List[Dict[int, str]] = []
    ends = []
    firings = 0
    for path in paths:
        log = read_log(path)
        hashes.append({})
        firings = 0
        for step in replay(log):
            hashes[-1][step.slot] = step.record["hash"]
            firings += len(step.firings)
            last = step
        ends.append((last.slot, log.plan.net.named(last.state.marking, zeros=False)))
    for (a, ours), (b, theirs) in itertools.combinations(zip(paths, hashes), 2):
        for slot in sorted(ours.keys() & theirs.keys()):
            if ours[slot] != theirs[slot]:
                raise ExecutionError("%s and %s differ at slot %d" % (a, b, slot))
    if any(end != ends[0] for end in ends):
        raise ExecutionError("the replicas do not end alike: %s" % dict(zip(paths, ends)))
    _verify(paths)
    return AgreedHistory(ends[0][0] + 1, firings, ends[0][1])


def _verify(paths: Sequence[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "gspn_framework_package", "verify", *paths],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
    )
    if done.returncode != 0:
        raise ExecutionError("gspn verify says no: %s" % done.stdout.strip())
