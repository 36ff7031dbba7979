"""Optimal policies against Storm, in one run.

``python3 -m benchmarks.decisions [--quick] [--whole] [--repeat N] [--markdown FILE]
[--json FILE]``

Each measurement runs in its own process; each is repeated, in turns, and the fastest counts. Both
build the Markov automaton from the same net and find the best policy: ours with bounds of a
relative width of 1e-6, Storm with its sound methods (1e-6 too) and with its plain default. Compiled
code is loaded before the clock starts. The waiting patrol is a plan, whose automaton Storm reads
from a file; building it is not counted on either side. Where stormpy is not installed, or does not
come to an end in ``--patience`` seconds, its columns stay empty.

``--whole`` compares whole processes, from start to end, on other nets. Then the fastest is the one
that took the least processor time: the machine may be busy with something else.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, List, NamedTuple, Optional, Sequence

from benchmarks.decision_nets import delivery, rendezvous, rooms
from benchmarks.harness.processes import peak_mb
from benchmarks.inspection_grid import inspection_grid
from benchmarks.machine import (
    LIBRARIES,
    describe_machine,
    machine_line,
    table,
)
from gspn_framework_package.model.net import Net

# the rest is imported where it is used: a process of Storm's does not pay for it
if TYPE_CHECKING:
    from gspn_framework_package.analysis.arrays import Booleans
    from gspn_framework_package.analysis.decisions.automaton import Automaton, Rewards
    from gspn_framework_package.analysis.state_space.space import StateSpace


class Case(NamedTuple):
    """A problem: its kind, the number of robots, a further size, whether the mean time to a
    condition is asked instead of a share of time, and how much there is of what robots work on."""

    kind: str
    robots: int
    size: int = 0
    time_to: bool = False
    room: int = 0

    @property
    def title(self) -> str:
        """Its name in the table."""
        aim = "mean time to all inspected" if self.time_to else "share of time"
        if self.kind == "patrol":
            return "patrol with WAIT, checks per second"
        if self.room:
            told = self.kind, self.robots, self.size, self.room
            return "%s, %d robots, %d places for %d each" % told
        what = "grid 3x3, %d levels" % self.size if self.kind == "grid" else "3 rooms"
        return "%s, %d robot%s, %s" % (what, self.robots, "s" * (self.robots > 1), aim)


CASES = (
    Case("grid", 1, 5),
    Case("grid", 2, 4),
    Case("grid", 2, 4, True),
    Case("rooms", 3),
    Case("rooms", 5),
    Case("rooms", 10),
    Case("patrol", 4),
)
QUICK = (Case("grid", 1, 4), Case("grid", 1, 4, True), Case("rooms", 3))
WHOLE = (
    Case("delivery", 2, 3, room=4),
    Case("grid", 1, 5),
    Case("delivery", 3, 3, room=4),
    Case("rendezvous", 4, 4, room=2),
    Case("delivery", 3, 4, room=3),
    Case("rendezvous", 5, 4, room=3),
    Case("grid", 2, 4),
    Case("delivery", 4, 4, room=3),
    Case("rendezvous", 6, 4, room=3),
    Case("grid", 2, 12),
)
"""With ``--whole``: from 5,000 to five million states."""

PATIENCE = 180
"""Seconds after which a measurement is given up."""

LARGEST = Case("grid", 2, 12)
"""With ``--large``: 5,334,849 states."""


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark, or (with ``--worker``) one measurement of it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small nets only")
    parser.add_argument("--whole", action="store_true", help="whole processes, other nets")
    parser.add_argument("--patience", type=float, default=PATIENCE, help="s (default %(default)s)")
    parser.add_argument("--large", action="store_true", help="also the largest one, ours alone")
    parser.add_argument("--repeat", type=int, default=2, metavar="N", help="(default 2)")
    parser.add_argument("--markdown", metavar="FILE", help="write the table there too")
    parser.add_argument("--json", metavar="FILE", help="write all measurements there")
    parser.add_argument("--worker", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    if args.worker:
        engine, text = args.worker
        print(json.dumps(_work(engine, Case(*json.loads(text)), args.whole)))
        return 0
    rows = []
    cases = (WHOLE[:2] if args.quick else WHOLE) if args.whole else QUICK if args.quick else CASES
    engines = ("storm", "ours") if args.whole else ("storm", "ours", "plain")
    for case in cases:
        rows.append(_measured(case, engines, args.repeat, args.patience, args.whole))
    if args.large:
        rows.append(_measured(LARGEST, ("ours",), 1, args.patience))
    machine = describe_machine((*LIBRARIES, "stormpy"))
    text = "%s\n\n%s" % (machine_line(machine), (_whole_table if args.whole else _table)(rows))
    print(text)
    if args.markdown:
        Path(args.markdown).write_text(text + "\n", encoding="utf-8")
    if args.json:
        report = {"machine": machine, "cases": rows}
        Path(args.json).write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return 0


# -- problems --------------------------------------------------------------------------------------


def net_of(case: Case) -> Net:
    """The net of a case."""
    if case.kind == "grid":
        return inspection_grid(3, case.robots, case.size)
    if case.room:
        made = delivery if case.kind == "delivery" else rendezvous
        return made(case.robots, case.size, case.room)
    return rooms(case.robots)


def condition_of(case: Case, net: Net) -> str:
    """What is asked about: where time is to be spent, or what is to be reached. For Storm and for
    us: no operator but ``&`` and ``|`` is used."""
    names = [p.name for p in net.places]
    if case.time_to:
        return " & ".join("(%s >= 1)" % n for n in names if n.startswith("done_"))
    start, joined, least = {
        "grid": ("inspecting_", " | ", 1),
        "rooms": ("tidy_", " & ", 2),
        "delivery": ("space_", " & ", 1),
        "rendezvous": ("pair_", " | ", 1),
    }[case.kind]
    return joined.join("(%s >= %d)" % (n, least) for n in names if n.startswith(start))


def automaton_of(space: StateSpace) -> Automaton:
    """The decision problem of a net: whoever decides chooses among the immediate transitions of
    weight 0, and chance among those with a weight."""
    import numpy as np

    from gspn_framework_package.analysis.decisions.automaton import CHANCE, Automaton
    from gspn_framework_package.analysis.state_space.rated_graph import firing_rate

    transitions, of = space.net.transitions, space.transitions
    weights = np.array([0.0 if t.timed else float(t.weight) for t in transitions])
    vanishing, sources = space.is_vanishing, space.sources
    counts = np.diff(space.offsets)
    decided = np.zeros(len(space), dtype=bool)
    decided[sources[vanishing[sources] & (weights[of] == 0)]] = True
    rows = np.concatenate([[0], np.cumsum(np.where(decided, counts, 1))])
    # one row per arc of a state in which somebody decides, one per other state
    of_rows = decided[np.repeat(np.arange(len(space)), np.diff(rows))]
    lengths = np.ones(int(rows[-1]), dtype=np.int64)
    lengths[~of_rows] = counts[~decided]
    values = np.ones(space.arcs)
    drawn = vanishing & ~decided
    sums = np.bincount(sources, weights=weights[of], minlength=len(space))
    by_chance = drawn[sources]
    values[by_chance] = (weights[of] / np.where(drawn, sums, 1.0)[sources])[by_chance]
    order = np.argsort(of, kind="stable")
    ends = np.searchsorted(of[order], np.arange(len(transitions) + 1))
    for t, transition in enumerate(transitions):
        arcs = order[ends[t] : ends[t + 1]]
        if transition.timed and len(arcs):
            values[arcs] = firing_rate(space.net, t, space.store, sources[arcs])
    choices = np.full(len(lengths), CHANCE, dtype=np.int32)
    arcs = np.concatenate([[0], np.cumsum(lengths)])
    choices[of_rows] = of[arcs[:-1][of_rows]]
    return Automaton(
        ~vanishing,
        rows,
        arcs,
        space.targets.astype(np.int32),
        values,
        of.astype(np.int32),
        choices,
        ((0, 1.0),),
    )


class WaitingPatrol(NamedTuple):
    """The decision problem of the patrol: at most one robot may be at a location, and robots may
    wait."""

    automaton: Automaton
    rewards: Rewards
    allowed: Booleans


def _patrol() -> WaitingPatrol:
    from gspn_framework_package.analysis.decisions.aims import Objective
    from gspn_framework_package.analysis.decisions.problem import DecisionProblem
    from gspn_framework_package.formats.example_plans import plans_folder
    from gspn_framework_package.formats.plan_file import read_plan

    plan = read_plan(str(Path(plans_folder(), "patrol", "plan.json")))
    names = [p.name for p in plan.net.places]
    never = ['"%s" + "%s" > 1' % (names[i], names[i + 1]) for i in range(0, 16, 4)]
    waiting = [name for name in names if "Decide" in name]
    decisions = DecisionProblem(
        plan, reading="net", never=never, may_wait=waiting, team_sizes=[len(plan.robots)]
    )
    team = decisions.teams[0]
    checks = {t.name: 1.0 for t in plan.net.transitions if "Temperature" in t.name}
    rewards = decisions.rewards(team, Objective.long_run(checks))
    return WaitingPatrol(team.automaton, rewards, decisions.allowed(team))


# -- measuring -------------------------------------------------------------------------------------

Measurement = Dict[str, Any]


def _measured(
    case: Case, engines: Sequence[str], repeat: int, patience: float, whole: bool = False
) -> Measurement:
    row: Measurement = {"case": case.title}
    for turn in range(repeat):
        for engine in engines:
            if turn and (engine not in row or row[engine]["total"] > 20):
                continue
            found = _measure(engine, case, patience, whole)
            key = "processor" if whole else "total"
            if found is not None and (engine not in row or found[key] < row[engine][key]):
                row[engine] = found
    print("%s: %s" % (case.title, {e: row.get(e) for e in engines}), file=sys.stderr)
    return row


def _measure(engine: str, case: Case, patience: float, whole: bool) -> Optional[Measurement]:
    command = [sys.executable, "-m", "benchmarks.decisions", *(["--whole"] if whole else [])]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    try:
        done = subprocess.run(
            [*command, "--worker", engine, json.dumps(case)],
            capture_output=True,
            text=True,
            timeout=patience,
            check=False,
        )
    except subprocess.TimeoutExpired:
        print("%s, %s: given up after %d s" % (case.title, engine, patience), file=sys.stderr)
        return None
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        print("%s, %s: %s" % (case.title, engine, last), file=sys.stderr)
        return None
    result: Measurement = json.loads(done.stdout.splitlines()[-1])
    if whole:
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        result["total"] = time.perf_counter() - start
        result["processor"] = sum(after[:2]) - sum(before[:2])
    return result


def _work(engine: str, case: Case, whole: bool) -> Measurement:
    if engine != "ours":
        return _storm(case, engine == "storm")
    if not whole:
        from gspn_framework_package.analysis.state_space import explore

        _ours(Case("grid", 1, 4), "numba")  # loads all code
        _ours(Case("grid", 1, 4, True), "numba")
        if case.kind != "patrol":
            explore(net_of(case), engine="numba", limit=100)
    return _ours(case, "auto" if whole else "numba")


def _ours(case: Case, engine: str) -> Measurement:
    from gspn_framework_package.analysis.decisions.aims import AIM_WIDTH, Aim
    from gspn_framework_package.analysis.decisions.automaton import Rewards
    from gspn_framework_package.analysis.decisions.solving import optimum
    from gspn_framework_package.analysis.state_space import explore

    start = time.perf_counter()
    goal: Optional[Booleans] = None
    allowed: Optional[Booleans] = None
    if case.kind == "patrol":
        automaton, rewards, allowed = _patrol()
        start = time.perf_counter()
    else:
        net = net_of(case)
        space = explore(net, engine=engine, limit=10**8)
        holds = space.holds(condition_of(case, net).replace("&", "and").replace("|", "or"))
        automaton = automaton_of(space)
        rewards = Rewards(holds.astype(float), 0.0 * space.targets)
        goal = holds if case.time_to else None
    built = time.perf_counter()
    solved = optimum(
        automaton,
        Aim.TIME_TO if case.time_to else Aim.LONG_RUN,
        rewards,
        goal=goal,
        allowed=allowed,
        maximise=not case.time_to,
        width=AIM_WIDTH,
    )
    done = time.perf_counter()
    return {
        "states": len(automaton),
        "build": built - start,
        "solve": done - built,
        "total": done - start,
        "lower": solved.lower,
        "upper": solved.upper,
        "value": 0.5 * (solved.lower + solved.upper),
        "method": "%s, %d rounds" % (solved.method, solved.rounds),
        "peak_mb": peak_mb(),
    }


def _storm(case: Case, sound: bool) -> Measurement:
    import stormpy

    from benchmarks.storm import storm_jani
    from gspn_framework_package.analysis.decisions.storm import automaton_in_drn

    start = time.perf_counter()
    if case.kind == "patrol":
        automaton, rewards, allowed = _patrol()
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "automaton.drn")
            file.write_text(automaton_in_drn(automaton, rewards, None, allowed), encoding="utf-8")
            model = stormpy.build_model_from_drn(str(file))
        properties = list(stormpy.parse_properties('R{"earned"}max=? [LRA]'))
        start = time.perf_counter()
    else:
        net = net_of(case)
        jani = storm_jani(net)
        text = "Tmin=? [F %s]" if case.time_to else "LRAmax=? [%s]"
        properties = list(stormpy.parse_properties(text % condition_of(case, net), jani))
        options = stormpy.BuilderOptions(properties, jani)
        options.set_apply_maximal_progress_assumption(True)
        model = stormpy.build_model(jani, options=options)
    built = time.perf_counter()
    environment = {} if sound else {"environment": stormpy.Environment()}
    result = stormpy.model_checking(model, properties[0], **environment)
    done = time.perf_counter()
    return {
        "states": model.nr_states,
        "build": built - start,
        "solve": done - built,
        "total": done - start,
        "value": float(result.get_value(model.initial_states[0])),
        "peak_mb": peak_mb(),
    }


# -- reporting -------------------------------------------------------------------------------------


def _whole_table(rows: List[Measurement]) -> str:
    head = ["problem", "states"]
    head += [name + what for what in (" s", " processor s", " MB") for name in ("ours", "Storm")]
    head += ["processor: Storm / ours", "memory: ours / Storm", "value", "Storm differs by"]
    keys = "total", "processor", "peak_mb"
    cells = []
    for row in rows:
        ours, storm = row.get("ours", {}), row.get("storm", {})
        both = bool(ours and storm)
        value = ours.get("value")
        cells.append(
            [
                row["case"],
                ours.get("states"),
                *(of.get(key) for key in keys for of in (ours, storm)),
                storm["processor"] / ours["processor"] if both else None,
                ours["peak_mb"] / storm["peak_mb"] if both else None,
                None if value is None else "%.9g" % value,
                abs(storm["value"] - value) / abs(value) if both else None,
            ]
        )
    return table(head, cells)


def _table(rows: List[Measurement]) -> str:
    head = (
        "problem",
        "states",
        "ours build s",
        "solve s",
        "Storm build s",
        "sound s",
        "plain s",
        "all: Storm sound / ours",
        "value",
        "width",
        "Storm differs by",
    )
    cells = []
    for row in rows:
        ours, storm, plain = (row.get(e, {}) for e in ("ours", "storm", "plain"))
        value = ours.get("value")
        known = value is not None and storm.get("value") is not None
        cells.append(
            [
                row["case"],
                ours.get("states"),
                ours.get("build"),
                ours.get("solve"),
                storm.get("build"),
                storm.get("solve"),
                plain.get("solve"),
                storm["total"] / ours["total"] if storm and ours else None,
                None if value is None else "%.9g" % value,
                None if value is None else (ours["upper"] - ours["lower"]) / abs(value),
                abs(storm["value"] - value) / abs(value) if known else None,
            ]
        )
    return table(head, cells)


if __name__ == "__main__":
    sys.exit(main())
