"""Compares our answers with the published ones, net by net."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import time
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence

import psutil

from benchmarks.literature.answers import CERTIFIED, Between, Subject
from benchmarks.literature.published import Published
from benchmarks.literature.questions import COUNTING, FAMILIES, VISITED, VISITING
from gspn_framework_package.model.errors import GspnError

BYTES_PER_STATE = 1_200
"""Peak memory for each state of a net that is visited: the largest of all processes of a run took
2.3 GB, with 2.5 million states. A net that would not fit into the free memory has no answer."""

AGREES, DIFFERS = "agrees", "DIFFERS"
EXPLAINED = "published is wrong: docs/literature.md"
STALE = "DIFFERS: agrees, but is listed as wrong"
UNANSWERED = "NO ANSWER: "


class Row(NamedTuple):
    """A published value beside ours (None: no answer), and the processor time (s) that the answer
    took."""

    published: Published
    ours: Optional[Between]
    seconds: float
    verdict: str

    @property
    def fails(self) -> bool:
        """Whether the values do not agree, and nothing explains why."""
        return self.verdict.startswith((DIFFERS, UNANSWERED))


def states_of(group: Sequence[Published]) -> int:
    """The published number of states of a net; 0: unknown."""
    return max((int(v.text) for v in group if v.answer in ("states", "tangible")), default=0)


def compare_all(
    groups: Sequence[Sequence[Published]], processes: int, certified: int = CERTIFIED
) -> Iterator[List[Row]]:
    """Compare the values of each net, in that many processes; the nets in the order in which they
    come to an end. What goes on is ended when the iterator is."""
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(processes, context) as pool:
        asked = [pool.submit(compare, group, certified) for group in groups]
        try:
            for done in concurrent.futures.as_completed(asked):
                yield done.result()
        except BaseException:
            for future in asked:
                future.cancel()
            for child in multiprocessing.active_children():
                child.terminate()
            raise


def compare(group: Sequence[Published], certified: int = CERTIFIED) -> List[Row]:
    """Answer all that is asked about one net, and compare the answers with what was published."""
    first = group[0]
    family = FAMILIES[first.family]
    states = states_of(group)
    counted = states > VISITED
    if not counted and states * BYTES_PER_STATE > psutil.virtual_memory().available:
        text = UNANSWERED + "it takes about %.0f GB of memory" % (states * BYTES_PER_STATE / 1e9)
        return [Row(value, None, 0.0, text) for value in group]
    answers: Dict[str, Any] = {**(COUNTING if counted else VISITING), **family.answers}
    started = time.process_time()
    net = family.build(first.size)
    subject = family.solver(net) if family.solver else Subject(net, certified)
    rows = []
    known: Dict[str, Between] = {}
    for value in group:
        ours: Optional[Between] = None
        try:
            if value.answer not in known:
                known[value.answer] = answers[value.answer](subject, first.size)
            ours = known[value.answer]
            verdict = _verdict(value, value.agrees(ours))
        except GspnError as error:
            verdict = UNANSWERED + error.message
        now = time.process_time()
        rows.append(Row(value, ours, now - started, verdict))
        started = now
    return rows


def _verdict(value: Published, agrees: bool) -> str:
    if value.wrong:
        return STALE if agrees else EXPLAINED
    return AGREES if agrees else DIFFERS
