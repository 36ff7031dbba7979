"""State spaces and steady states against Storm, in one run.

``python3 -m benchmarks.analysis [--quick] [--part PART] [--markdown FILE]
[--json FILE]``

Every measurement runs in its own process, so that its peak memory is its own; each is repeated,
engine after engine (not those that take more than 10 s), and the fastest counts. Times are what a
clock on the wall says: the numba engine uses all cores, Storm and numpy one, so close what else
runs. Compiled code is loaded before the clock starts. Storm builds with its sparse engine and
maximal progress. Where stormpy is not installed its columns stay empty.

``--whole`` compares state spaces as whole processes, from the start of Python on, after a first one
has compiled what is kept; the median of the turns counts.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from benchmarks import nets
from benchmarks.harness.processes import peak_mb
from benchmarks.machine import (
    LIBRARIES,
    describe_machine,
    machine_line,
    table,
)
from benchmarks.nets import FAMILIES
from gspn_framework_package.model.net import Net

SPACES = (
    ("kanban", 3),
    ("kanban", 4),
    ("kanban", 5),
    ("fms", 4),
    ("fms", 5),
    ("philosophers", 12),
    ("philosophers", 14),
    ("philosophers", 16),
    ("polling", 15),
    ("courier", 1),
    ("courier", 2),
)
QUICK_SPACES = (("kanban", 3), ("fms", 3), ("philosophers", 12))
CHAINS = (("kanban", 3), ("kanban", 4), ("fms", 2), ("fms", 3), ("polling", 12), ("courier", 1))
QUICK_CHAINS = (("kanban", 3), ("fms", 2))
ENGINES = ("storm", "numba", "numpy")

_NET = "from benchmarks.nets import FAMILIES; net = FAMILIES[%r](%d)\n"
WHOLE = {
    "ours": _NET
    + "from gspn_framework_package.analysis.state_space import explore\n"
    + "print(len(explore(net, limit=10**9)))",
    "Storm": _NET
    + "from benchmarks.storm import storm_jani\n"
    + "import stormpy\n"
    + "options = stormpy.BuilderOptions()\n"
    + "options.set_apply_maximal_progress_assumption(True)\n"
    + "print(stormpy.build_model(storm_jani(net), options=options).nr_states)",
}
"""The programs that ``--whole`` compares."""


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark, or (with ``--worker``) one measurement of it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small nets only")
    parser.add_argument(
        "--part", choices=("spaces", "chains"), help="state spaces, or Markov chains; else both"
    )
    parser.add_argument(
        "--repeat", type=int, default=3, metavar="N", help="of each measurement (default 3)"
    )
    parser.add_argument("--markdown", metavar="FILE", help="write the tables there too")
    parser.add_argument("--json", metavar="FILE", help="write all measurements there")
    parser.add_argument("--whole", action="store_true", help="state spaces as whole processes")
    parser.add_argument("--worker", nargs=4, help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    if args.worker:
        work, engine, family, size = args.worker
        print(json.dumps(WORK[work](engine, FAMILIES[family](int(size)))))
        return 0
    spaces, chains = (QUICK_SPACES, QUICK_CHAINS) if args.quick else (SPACES, CHAINS)
    if args.whole:
        rows = [_whole(family, size, args.repeat) for family, size in spaces]
        print(
            "%s\n\n%s" % (machine_line(describe_machine((*LIBRARIES, "stormpy"))), _in_rows(rows))
        )
        if args.json:
            Path(args.json).write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
        return 0
    measured_spaces = _measure_all("space", spaces, args.repeat) if args.part != "chains" else []
    measured_chains = _measure_all("chain", chains, args.repeat) if args.part != "spaces" else []
    text = _report(measured_spaces, measured_chains)
    print(text)
    if args.markdown:
        Path(args.markdown).write_text(text + "\n", encoding="utf-8")
    if args.json:
        machine = describe_machine((*LIBRARIES, "stormpy"))
        report = {"machine": machine, "spaces": measured_spaces, "chains": measured_chains}
        Path(args.json).write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return 0


# -- measuring -------------------------------------------------------------------------------------

Measurement = Dict[str, Any]


def _measure_all(work: str, which: Sequence[Tuple[str, int]], repeat: int) -> List[Measurement]:
    found = []
    for family, size in which:
        row: Measurement = {"net": "%s %d" % (family, size)}
        runs: Dict[str, List[Measurement]] = {engine: [] for engine in ENGINES}
        for _ in range(repeat):
            for engine in ENGINES:
                if runs[engine] and runs[engine][0]["seconds"] > 10:
                    continue
                result = _measure(work, engine, family, size)
                if result is not None:
                    runs[engine].append(result)
        for engine, results in runs.items():
            if results:
                row[engine] = min(results, key=lambda r: float(r["seconds"]))
                row[engine]["peak_mb"] = min(r["peak_mb"] for r in results)
        counts = {row[e]["states"] for e in ENGINES if e in row and "states" in row[e]}
        assert len(counts) <= 1, "the engines disagree on %s: %s" % (row["net"], counts)
        print(
            "%s: %s" % (row["net"], {e: row[e]["seconds"] for e in ENGINES if e in row}),
            file=sys.stderr,
        )
        found.append(row)
    return found


def _measure(work: str, engine: str, family: str, size: int) -> Optional[Measurement]:
    command = [sys.executable, "-m", "benchmarks.analysis"]
    done = subprocess.run(
        [*command, "--worker", work, engine, family, str(size)],
        capture_output=True,
        text=True,
        timeout=1800,
        check=False,
    )
    if done.returncode:
        print(
            "%s %s %d: %s" % (engine, family, size, done.stderr.strip().splitlines()[-1]),
            file=sys.stderr,
        )
        return None
    result: Measurement = json.loads(done.stdout.splitlines()[-1])
    return result


def _whole(family: str, size: int, repeat: int) -> Measurement:
    """Medians over ``repeat`` turns: seconds by the clock and of a processor, and peak memory (MB),
    of whole processes. What takes more than 10 s has one turn."""
    row: Measurement = {"net": "%s %d" % (family, size)}
    turns: Dict[str, List[Tuple[float, float, float]]] = {name: [] for name in WHOLE}
    for turn in range(repeat + 1):
        for name, program in WHOLE.items():
            if turns[name] and turns[name][0][0] > 10 or (turn == 0 and name == "Storm"):
                continue  # turn 0 compiles
            start = time.perf_counter()
            with subprocess.Popen(
                [sys.executable, "-c", program % (family, size)],
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            ) as process:
                assert process.stdout is not None
                printed = process.stdout.read().split()
                _, status, used = os.wait4(process.pid, 0)
                process.returncode = os.waitstatus_to_exitcode(status)
            seconds = time.perf_counter() - start
            if process.returncode:
                continue
            states = int(printed[-1])
            assert row.setdefault("states", states) == states, "the engines disagree"
            if turn:
                turns[name].append((seconds, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024))
    for name, found in turns.items():
        if found:
            keys = "seconds", "processor", "peak_mb"
            row[name] = {key: median(values) for key, values in zip(keys, zip(*found))}
    print(json.dumps(row), file=sys.stderr)
    return row


def _in_rows(rows: Sequence[Measurement]) -> str:
    head = ["net", "states"]
    head += [name + what for what in (" s", " processor s", " MB") for name in WHOLE]
    cells = []
    for row in rows:
        parts = [row.get(name, {}) for name in WHOLE]
        cell = [row["net"], row.get("states")]
        cell += [part.get(key) for key in ("seconds", "processor", "peak_mb") for part in parts]
        ours, storm = (part.get("seconds") for part in parts)
        cells.append([*cell, storm / ours if ours and storm else None])
    return table([*head, "Storm / ours"], cells)


def _space(engine: str, net: Net) -> Measurement:
    """Time (s) and additional memory (MB) needed to find the state space."""
    if engine == "storm":
        import stormpy

        from benchmarks.storm import storm_jani

        def build(net: Net) -> Tuple[Callable[[], Any], Callable[[Any], Any]]:
            jani = storm_jani(net)
            options = stormpy.BuilderOptions()
            options.set_apply_maximal_progress_assumption(True)
            return (lambda: stormpy.build_model(jani, options=options)), (
                lambda model: model.nr_states
            )

    else:
        from gspn_framework_package.analysis.state_space import explore

        def build(net: Net) -> Tuple[Callable[[], Any], Callable[[Any], Any]]:
            return (lambda: explore(net, engine=engine, limit=10**9)), len

    build(nets.kanban(1))[0]()  # loads all code
    build(nets.philosophers(12))[0]()
    run, count = build(net)
    before = peak_mb()
    start = time.perf_counter()
    result = run()
    seconds = time.perf_counter() - start
    return {
        "states": int(count(result)),
        "seconds": seconds,
        "peak_mb": max(peak_mb() - before, 0.0),
    }


def _chain(engine: str, net: Net) -> Measurement:
    """Times (s) of building the chain and solving its steady state, and the probability that the
    first place is not empty."""
    place = net.places[0].name
    if engine == "storm":
        return _storm_chain(net, place)
    if engine == "numpy":
        sys.modules["numba"] = None  # type: ignore[assignment]  # as if it were not installed
    from gspn_framework_package.analysis.chain import Chain
    from gspn_framework_package.analysis.solution.steady_state import steady_state
    from gspn_framework_package.analysis.state_space import explore

    for small in (nets.kanban(2), nets.philosophers(12)):  # loads all code
        steady_state(Chain.of(explore(small, engine=engine)))
    before = peak_mb()
    start = time.perf_counter()
    chain = Chain.of(explore(net, engine=engine))
    built = time.perf_counter()
    steady = steady_state(chain)
    done = time.perf_counter()
    value = float(steady.distribution[chain.column(0) >= 1].sum())
    return {
        "build": built - start,
        "seconds": done - built,
        "value": value,
        "residual": steady.residual,
        "method": steady.method,
        "peak_mb": max(peak_mb() - before, 0.0),
    }


def _storm_chain(net: Net, place: str) -> Measurement:
    import stormpy

    from benchmarks.storm import storm_jani

    nondeterministic = any(not t.timed for t in net.transitions)
    jani = storm_jani(net)
    formula = "LRA%s=? [%s >= 1]" % ("min" if nondeterministic else "", place)
    properties = list(stormpy.parse_properties(formula, jani))
    options = stormpy.BuilderOptions(properties, jani)
    options.set_apply_maximal_progress_assumption(True)
    before = peak_mb()
    start = time.perf_counter()
    model = stormpy.build_model(jani, options=options)
    built = time.perf_counter()
    result = stormpy.model_checking(model, properties[0])  # stormpy requests sound results
    done = time.perf_counter()
    plain = stormpy.model_checking(model, properties[0], environment=stormpy.Environment())
    plainly = time.perf_counter() - done
    value, plain_value = (float(r.get_value(model.initial_states[0])) for r in (result, plain))
    return {
        "build": built - start,
        "seconds": done - built,
        "value": value,
        "plain_seconds": plainly,
        "plain_value": plain_value,
        "peak_mb": max(peak_mb() - before, 0.0),
    }


WORK: Mapping[str, Callable[[str, Net], Measurement]] = {"space": _space, "chain": _chain}


# -- reporting -------------------------------------------------------------------------------------


def _report(spaces: List[Measurement], chains: List[Measurement]) -> str:
    def ratio(row: Measurement, engine: str) -> Optional[float]:
        if "storm" not in row or engine not in row:
            return None
        return float(row["storm"]["seconds"] / row[engine]["seconds"])

    def get(row: Measurement, engine: str, key: str) -> Any:
        return row.get(engine, {}).get(key)

    space_rows = [
        [r["net"], next(r[e]["states"] for e in ENGINES if e in r)]
        + [get(r, e, "seconds") for e in ENGINES]
        + [ratio(r, "numba"), ratio(r, "numpy")]
        + [get(r, e, "peak_mb") for e in ENGINES]
        for r in spaces
    ]
    chain_rows = [
        [r["net"]]
        + [get(r, e, "build") for e in ENGINES]
        + [get(r, "storm", "plain_seconds")]
        + [get(r, e, "seconds") for e in ENGINES]
        + [get(r, "numba", "residual"), get(r, "numpy", "residual")]
        + [_difference(r, "value"), _difference(r, "plain_value")]
        for r in chains
    ]
    return "\n".join(
        [
            machine_line(describe_machine((*LIBRARIES, "stormpy"))),
            "",
            "State space, seconds (x: times as fast as Storm; MB: peak memory beyond what the "
            "libraries take)",
            "",
            table(
                (
                    "net",
                    "states",
                    "Storm s",
                    "numba s",
                    "numpy s",
                    "numba x",
                    "numpy x",
                    "Storm MB",
                    "numba MB",
                    "numpy MB",
                ),
                space_rows,
            ),
            "",
            "Markov chain and steady state, seconds (Storm's plain default, and sound to 1e-6; "
            "residuals are ours)",
            "",
            table(
                (
                    "net",
                    "build Storm s",
                    "numba s",
                    "numpy s",
                    "steady Storm plain s",
                    "sound s",
                    "numba s",
                    "numpy s",
                    "numba residual",
                    "numpy residual",
                    "sound differs by",
                    "plain differs by",
                ),
                chain_rows,
            ),
        ]
    )


def _difference(row: Measurement, key: str) -> Optional[float]:
    if "storm" not in row or "numba" not in row:
        return None
    return abs(float(row["storm"][key]) - float(row["numba"]["value"]))


if __name__ == "__main__":
    sys.exit(main())
