"""The report of a net whose markings may not fit into memory and are then stored on disk."""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, Optional, Tuple

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.on_disk.chain import OnDiskChain
from gspn_framework_package.analysis.on_disk.reach import cover, reach
from gspn_framework_package.analysis.on_disk.scratch import Scratch
from gspn_framework_package.analysis.on_disk.search import OnDiskSpace, search
from gspn_framework_package.analysis.on_disk.steady import steady_state_on_disk
from gspn_framework_package.analysis.plan.reading import NET, TimingNotes
from gspn_framework_package.analysis.report import (
    ON_DISK,
    Questions,
    ReportWork,
    report,
)
from gspn_framework_package.analysis.report_measures import MEASURES, Part
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.net import Net

_BYTES_PER_STATE = 240
"""Memory per marking assumed by the first attempt, in memory: twice the peak use of large state
spaces."""

_NOT_ON_DISK = "not answered on disk: it needs the graph of all markings in memory"


def report_within(
    memory: float,
    net: Net,
    questions: Questions,
    scratch: Scratch,
    make: Callable[[Limits], Analysis],
    limits: Limits,
    *,
    seconds: float = math.inf,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Tuple[Analysis, Dict[str, Any]]:
    """The analysis and its report, see :func:`~gspn_framework_package.analysis.report.report`.

    The markings are visited in memory first. If they take too much of it, they are visited again on
    disk. Then ``engine`` is ``disk``, and questions that need the whole graph in memory are not
    answered.

    :param memory: bytes to use, in addition to those of the libraries and the net.
    :param make: makes an analysis of ``net`` with the given limits.
    :param limits: its ``states`` apply on disk too.
    :param seconds: longest time (s) of the search on disk.
    :raises GspnError: see :func:`~.search.search`.
    """
    most = max(int(memory / _BYTES_PER_STATE), 1)
    states = most if limits.states is None else min(limits.states, most)
    first = make(limits._replace(states=states, memory=int(memory)))
    space = first.space
    if space.complete or states == limits.states or first.boundedness.bounded is False:
        return first, report(first, questions)
    del first, space  # and their memory
    questions.check(net)
    found = search(
        net,
        memory,
        scratch=scratch,
        limit=math.inf if limits.states is None else limits.states,
        seconds=seconds,
        progress=progress,
        cancel=cancel,
    )
    analysis = make(limits._replace(states=len(found), memory=int(memory)))

    def watch() -> Watch:
        return Watch(progress, cancel, seconds=seconds)

    try:
        return analysis, _report_of(analysis, found, questions, memory, watch)
    finally:
        scratch.close()


def _report_of(
    analysis: Analysis,
    space: OnDiskSpace,
    questions: Questions,
    memory: float,
    watch: Callable[[], Watch],
) -> Dict[str, Any]:
    work = ReportWork(analysis)
    work.basics()
    if questions.structure:
        work.structure()
    _behaviour(work, space)

    def leave_out(key: str, why: str = _NOT_ON_DISK) -> None:
        work.data[key] = None
        work.undecided[key] = why

    for measure in MEASURES:
        if measure.part is Part.BEHAVIOUR and measure.key not in work.data:
            leave_out(measure.key)
    for condition in questions.reach:
        work.reach(condition, lambda text: reach(space, text, watch()))
    for marking in questions.cover:
        work.cover(marking, lambda counts: cover(space, counts, watch()))
    if questions.timing:
        work.answer("steady_state", lambda: _steady(space, questions, memory, watch))
    if questions.mean_time_to:
        work.data["mean_time_to"] = [None] * len(questions.mean_time_to)
        work.undecided["mean_time_to"] = _NOT_ON_DISK
    if questions.settling is not None:
        leave_out("time_to_steady_state")
    if questions.at:
        leave_out("transient")
    work.data["scratch_bytes"] = space.scratch.peak
    work.data["scratch"] = str(space.scratch.folder)
    work.finish()
    return work.data


def _steady(
    space: OnDiskSpace, questions: Questions, memory: float, watch: Callable[[], Watch]
) -> Dict[str, Any]:
    found = steady_state_on_disk(OnDiskChain(space, memory, watch()), watch())
    if questions.rewards:
        known = {**found["throughput"], **found["mean_tokens"]}
        found["reward"] = math.fsum(v * known[n] for n, v in questions.rewards.items())
    return found


def _behaviour(work: ReportWork, space: OnDiskSpace) -> None:
    counts, data = space.counts, work.data
    data["states"] = {
        "total": counts.states,
        "tangible": counts.states - counts.vanishing,
        "vanishing": counts.vanishing,
        "arcs": counts.arcs,
    }
    data["left_out"] = []
    data["timing"] = TimingNotes(NET, {}, [])._asdict()
    data["engine"] = ON_DISK
    data["memory_bytes"] = work.analysis.limits.memory
    data["bounded"] = True
    data["bounds"] = counts.bounds
    dead = space.dead_marking()
    data["deadlocks"] = {
        "count": counts.dead,
        "witness": None if dead is None else dead[0],
        "marking": None if dead is None else space.net.named(dead[1], zeros=False),
    }
    data["k_safe"] = max(counts.bounds.values(), default=0)
    data["dead_transitions"] = [name for name, number in counts.firings.items() if not number]
    if data["dead_transitions"] or counts.dead:
        data["live"] = False
    if counts.dead and counts.states > 1:
        data["reversible"] = False
