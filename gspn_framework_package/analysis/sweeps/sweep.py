"""A sweep: the measures of a net or plan for each point of a grid of variations.

All points are measured together: their replications are distributed as workers become free, so none
waits for the slowest point.

>>> from gspn_framework_package.model.builder import NetBuilder
>>> net = (NetBuilder().place("up", tokens=1).place("down")
...        .exponential("fail", rate=1.0, inputs="up", outputs="down")
...        .exponential("repair", rate=3.0, inputs="down", outputs="up").build())
>>> sweep = Sweep(net, [read_variation("rate:repair=1,3,9")], exact=True)
>>> [(point.values, round(point.measures["throughput"]["fail"][0], 3)) for point in sweep.run()]
[((1.0,), 0.5), ((3.0,), 0.75), ((9.0,), 0.9)]
"""

from __future__ import annotations

import hashlib
import json
import math
from fnmatch import fnmatchcase
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

from gspn_framework_package import __version__
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.executors import Executor, LocalExecutor, WorkItem, Workload
from gspn_framework_package.analysis.intervals import steady_intervals
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.plan.subnets import TITLES
from gspn_framework_package.analysis.simulation import Asked, Simulation, SimulationWork, finished
from gspn_framework_package.analysis.sweeps.variation import (
    Variation,
    VariedValue,
    grid,
    read_variation,
    varied,
)
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy

PointMeasures = Dict[str, Dict[str, Tuple[float, Optional[float]]]]
"""Measure -> name of the place, transition or subnet (or "") -> mean, half width (None: unbounded).
"""

_OF_A_RUN = ("end_time", "reached", "time_to_condition")
"""Measures of a run as a whole."""


class SweepPoint(NamedTuple):
    """A measured point of the grid.

    :ivar number: its number in the grid, from 0.
    :ivar values: a value for each variation.
    :ivar key: a digest of all that the measures depend on.
    :ivar replications: number of runs; 0: the measures are computed.
    :ivar notes: what the half widths of computed measures take into account: sentences for
        people.
    """

    number: int
    values: Tuple[VariedValue, ...]
    key: str
    measures: PointMeasures
    replications: int
    notes: Sequence[str] = ()


class Sweep:
    """The measurements to make.

    :param subject: a net or a validated plan.
    :param variations: the parameters to vary.
    :param asked: the simulation of each point.
    :param exact: compute the steady state instead of simulating.
    :param limits: limits of the exact analysis.
    :param phases: the most phases of each duration there, as of ``Analysis``.
    :param policies: the policies of the variation ``policy``, by the names of their files.
    :ivar keys: the key of each point, in the order of the grid.
    :raises GspnError: a variation does not fit the subject, or the settings are invalid.
    """

    def __init__(
        self,
        subject: Union[Net, Plan],
        variations: Sequence[Variation],
        asked: Asked = Asked(),  # noqa: B008 (immutable)
        *,
        exact: bool = False,
        limits: Limits = Limits(),  # noqa: B008 (immutable)
        phases: Optional[int] = None,
        policies: Optional[Mapping[str, Policy]] = None,
    ) -> None:
        self.variations = tuple(variations)
        self.points = grid(variations)
        self.asked, self.exact = asked, exact
        self._limits, self._phases = limits, phases
        self._subjects = [
            varied(subject, variations, values, policies or {}, asked.timing)
            for values in self.points
        ]
        self.keys = [self._key(subject) for subject in self._subjects]

    def _key(self, subject: Union[Net, Plan]) -> str:
        content = plan_to_json(subject) if isinstance(subject, Plan) else net_to_json(subject)
        how: Any = self.asked._asdict()
        if self.exact:  # the number of states limits that of phases
            how = {"exact": self.asked.timing, "phases": [self._phases, self._limits.states]}
        text = json.dumps([__version__, how, content], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def title(self, number: int) -> str:
        """A point in words: ``robots=3, rate:check=0.5``."""
        return ", ".join(
            "%s=%s" % (variation.name, "%g" % value if isinstance(value, float) else value)
            for variation, value in zip(self.variations, self.points[number])
        )

    def run(
        self,
        known: Optional[Mapping[str, SweepPoint]] = None,
        on: Optional[Executor] = None,
        watch: Optional[Watch] = None,
    ) -> Iterator[SweepPoint]:
        """Yield each point as soon as it is measured.

        :param known: points measured before, by their keys; they are yielded first.
        :param on: where to compute: by default in this process.
        :param watch: receives the progress, and may stop the work.
        :raises GspnError: a point cannot be measured; the message names it.
        """
        missing = []
        for number, key in enumerate(self.keys):
            if known is not None and key in known:
                yield known[key]._replace(number=number, values=self.points[number])
            else:
                missing.append(number)
        watch = watch or Watch()
        executor = on or LocalExecutor()
        measured = self._analysed if self.exact else self._simulated
        yield from measured(missing, executor, watch)

    def to_json(
        self, points: Sequence[SweepPoint], wanted: Sequence[Tuple[str, str]]
    ) -> Dict[str, Any]:
        """The varied parameters and the requested measures of these points, as plain JSON
        values."""
        found = []
        for point in sorted(points):
            measures: Dict[str, Dict[str, Any]] = {}
            for measure, name in wanted:
                if name in point.measures.get(measure, {}):
                    mean, half = point.measures[measure][name]
                    measures.setdefault(measure, {})[name] = {"mean": mean, "half_width": half}
            values = dict(zip((v.name for v in self.variations), point.values))
            found.append(
                {
                    "values": values,
                    "replications": point.replications,
                    "measures": measures,
                    "notes": list(point.notes),
                }
            )
        vary = [{"name": v.name, "values": list(v.values)} for v in self.variations]
        named = [{"measure": measure, "name": name} for measure, name in wanted]
        return {"vary": vary, "measures": named, "points": found}

    def _point(
        self, number: int, measures: PointMeasures, replications: int, notes: Sequence[str] = ()
    ) -> SweepPoint:
        values, key = self.points[number], self.keys[number]
        return SweepPoint(number, values, key, measures, replications, notes)

    def _simulated(
        self, numbers: Sequence[int], executor: Executor, watch: Watch
    ) -> Iterator[SweepPoint]:
        works = [
            SimulationWork(self._subjects[n], self.asked, executor.workers, self.title(n))
            for n in numbers
        ]
        for i in finished(works, executor, watch):
            result = works[i].result()
            yield self._point(numbers[i], measures_of(result), result.replications)

    def _analysed(
        self, numbers: Sequence[int], executor: Executor, watch: Watch
    ) -> Iterator[SweepPoint]:
        shared = (self._limits, self.asked.timing, self._phases)
        workload = Workload(tuple, _analyse, shared)
        items = [WorkItem(workload, self._subjects[n], 1, self.title(n)) for n in numbers]
        for i, (measures, notes) in executor.map(items, "points", watch):
            yield self._point(numbers[i], measures, 0, notes)


def _analyse(shared: Any, subject: Any, watch: Watch) -> Tuple[PointMeasures, List[str]]:
    limits, timing, phases = shared
    analysis = Analysis(
        subject,
        limits=limits,
        timing=timing if isinstance(subject, Plan) else None,
        structure=False,
        phases=phases,
        cancel=watch.cancelled,
    )
    return steady_intervals(analysis)


def measures_of(result: Simulation) -> PointMeasures:
    """All means of a simulation."""
    found: Dict[str, Mapping[str, Any]] = {
        "mean_tokens": result.mean_tokens,
        "throughput": result.throughput,
        **result.subnets,
    }
    for name in _OF_A_RUN:
        estimate = getattr(result, name)
        if estimate is not None:
            found[name] = {"": estimate}
    return {
        measure: {
            name: (e.mean, e.half_width if math.isfinite(e.half_width) else None)
            for name, e in values.items()
            if math.isfinite(e.mean)
        }
        for measure, values in found.items()
    }


def chosen(
    subject: Union[Net, Plan], wanted: Sequence[str], conditional: bool
) -> List[Tuple[str, str]]:
    """The measures selected by names, as pairs (measure, name).

    :param wanted: transitions (throughput), places (mean tokens), :data:`_OF_A_RUN`, or a measure
        of subnets with a subnet (``subnet_time:lift``); names may be patterns. Without names: the
        end time if runs end at a condition, otherwise all throughputs.
    :raises UsageError: nothing has such a name.
    """
    net = subject.net if isinstance(subject, Plan) else subject
    subnets = list(subject.subnets) if isinstance(subject, Plan) else []
    every = [("throughput", t.name) for t in net.transitions]
    if not wanted:
        return [("end_time", ""), ("reached", "")] if conditional else every
    every += [("mean_tokens", p.name) for p in net.places]
    named = [(name, (measure, name)) for measure, name in every]
    named += [(name, (name, "")) for name in _OF_A_RUN]
    named += [(m + ":" + s, (m, s)) for m in TITLES for s in subnets]
    found: Dict[Tuple[str, str], None] = {}
    for pattern in wanted:
        pairs = [pair for name, pair in named if name == pattern or fnmatchcase(name, pattern)]
        if not pairs:
            raise UsageError(
                "there is no '%s' to measure" % pattern,
                hint="--measure takes transitions, places, %s" % ", ".join(_OF_A_RUN),
            )
        found.update(dict.fromkeys(pairs))
    return list(found)


__all__ = ["SweepPoint", "Sweep", "chosen", "read_variation"]
