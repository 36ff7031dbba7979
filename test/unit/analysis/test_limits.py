"""Every part of an analysis has a limit, keeps to it, and says which option to raise."""

import json
import os
import signal
import subprocess
import sys
import threading

import pytest
from waiting import PATIENCE, wait_for

from benchmarks.large_nets import cells, ring, workflow
from benchmarks.nets import kanban, philosophers
from gspn_framework_package.analysis import analyse
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.limits import (
    LARGE_NET,
    STATE_LIMIT,
    STRUCTURE_LIMIT,
    Limits,
    states_of,
    structure_of,
)
from gspn_framework_package.analysis.report import Questions, report
from gspn_framework_package.analysis.structure import invariants
from gspn_framework_package.cli.limits import working
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import write_net
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import CancelledError, LimitError


def test_without_structure_no_invariant_is_looked_for(monkeypatch):
    def fail(*_, **__):
        raise AssertionError("nobody asked for it")

    monkeypatch.setattr(invariants, "_place_semiflows", fail)
    monkeypatch.setattr(analyse, "CoverabilityTree", fail)
    data = report(
        Analysis(workflow(120), structure=False), Questions(structure=False, timing=False)
    )
    assert data["states"]["total"] > 1 and data["bounded"]


@pytest.mark.parametrize("limits", [Limits(), Limits(structure=50)])
def test_invariants_are_looked_for_once(monkeypatch, limits):
    searches = []
    search = invariants._place_semiflows

    def count(*args):
        searches.append(args)
        return search(*args)

    monkeypatch.setattr(invariants, "_place_semiflows", count)
    monkeypatch.setattr(analyse, "BEGINNING", 10)  # so that bounds are asked for
    data = report(Analysis(ring(30), limits=limits), Questions())
    assert data["states"]["total"] == 30
    assert len(searches) == 1


def test_what_is_small_enough_is_visited_before_anything_else_is_asked(monkeypatch):
    monkeypatch.setattr(analyse, "CoverabilityTree", None)
    assert Analysis(kanban(2)).boundedness.bounded


@pytest.mark.parametrize(
    ("limits", "key", "option"),
    [
        (Limits(structure=50), "place_invariants", "--limit-structure"),
        (Limits(structure=50), "siphons", "--limit-structure"),
        (Limits(structure=50), "siphons_hold_marked_traps", "--limit-structure"),
        (Limits(states=50), "liveness", "--limit"),
        (Limits(states=50), "steady_state", "--limit"),
        (Limits(memory=20_000), "states", "--limit-memory"),
        (Limits(seconds=1e-9), "states", "--limit-time"),
        (Limits(seconds=1e-9), "liveness", "--limit-time"),
    ],
)
def test_the_limit_that_was_met_is_named(limits, key, option):
    data = report(Analysis(philosophers(6), limits=limits, engine="numpy"))
    assert data[key] is None
    assert "raise %s" % option in data["undecided"][key]
    assert data["limits"]["states"] == (limits.states or STATE_LIMIT)
    assert data["limits"]["memory_bytes"] == limits.memory


def test_a_coverability_tree_keeps_to_its_limits():
    net = philosophers(8)  # bounded: the tree has as many markings as the state space
    for limits, option in (
        (Limits(states=10, tree=20), "--limit-tree"),
        (Limits(states=30_000, memory=60_000), "--limit-memory"),
        (Limits(states=30_000, seconds=1e-9), "--limit-time"),
    ):
        with pytest.raises(LimitError, match=option):
            assert Analysis(net, limits=limits).tree.bounds


@pytest.mark.long
@pytest.mark.parametrize("part", ["steady", "at", "first_passage", "time_to_steady_state"])
def test_times_have_a_time_limit(part):
    analysis = Analysis(kanban(3), limits=Limits(seconds=300))
    analysis.chain.rates  # noqa: B018 (it is there before the time is over)
    analysis.limits = analysis.limits._replace(seconds=1e-9)
    ask = {
        "steady": lambda: analysis.steady,
        "at": lambda: analysis.at([1e6]),
        "first_passage": lambda: analysis.first_passage("machine1 == 3 and machine2 == 3"),
        "time_to_steady_state": lambda: analysis.time_to_steady_state(),
    }
    with pytest.raises(LimitError, match="--limit-time"):
        ask[part]()


@pytest.mark.parametrize(
    ("net", "parts"),
    [
        (workflow(1000), ("place_invariants", "transition_invariants", "siphons")),
        (cells(100), ("place_invariants", "siphons", "unguarded_siphon")),
    ],
    ids=["workflow", "cells"],
)
def test_every_part_can_be_cancelled(net, parts):
    for part in parts:
        analysis = Analysis(net, limits=Limits(structure=10**12), cancel=lambda: True)
        with pytest.raises(CancelledError):
            getattr(analysis.structure, part)
    for part in ("space", "tree"):
        with pytest.raises(CancelledError):
            getattr(Analysis(net, cancel=lambda: True), part)


@pytest.mark.long
def test_large_nets_have_fewer_states_unless_one_asks():
    assert states_of(LARGE_NET) == STATE_LIMIT > states_of(10 * LARGE_NET) > 100_000
    assert Analysis(ring(20_000)).limits.states == states_of(40_000)
    assert structure_of(LARGE_NET) == STRUCTURE_LIMIT == 2 * structure_of(4 * LARGE_NET)
    assert structure_of(20 * LARGE_NET) > 6 * 20 * LARGE_NET  # enough where nothing branches
    assert Analysis(ring(20_000)).limits.structure == structure_of(40_000)
    assert Analysis(ring(20), limits=Limits(structure=50)).limits.structure == 50
    assert Analysis(ring(20_000), limit=5).limits.states == 5


@pytest.mark.long
def test_a_large_net_is_answered():
    data = report(Analysis(ring(4_000)), Questions(at=(1.0,), mean_time_to=("p20 == 1",)))
    assert data["undecided"] == {}
    assert data["states"]["total"] == 4_000 and data["live"] and data["reversible"]
    assert data["steady_state"]["mean_tokens"]["p17"] == pytest.approx(1 / 4_000)
    assert data["steady_state"]["token_distribution"]["p17"] == pytest.approx(
        {"0": 1 - 1 / 4_000, "1": 1 / 4_000}
    )
    assert data["mean_time_to"][0]["mean_time"] == pytest.approx(20)


@pytest.mark.long
def test_servers_and_counts_of_a_large_net():
    builder = NetBuilder("wide").place("crew", tokens=3)
    for i in range(1_000):
        builder.place("idle%d" % i, tokens=i % 2).place("busy%d" % i)
    for i in range(0, 1_000, 500):
        builder.exponential(
            "start%d" % i, rate=2.0, servers=None, inputs="crew", outputs="busy%d" % i
        )
        builder.exponential(
            "stop%d" % i, rate=1.0, servers=None, inputs="busy%d" % i, outputs="crew"
        )
    net = builder.build()
    means = {}
    for engine in ("numpy", "sparse"):
        means[engine] = Analysis(net, engine=engine).measures
    assert means["sparse"].mean_tokens == pytest.approx(means["numpy"].mean_tokens)
    assert means["sparse"].token_distribution["crew"] == pytest.approx(
        means["numpy"].token_distribution["crew"]
    )
    assert means["sparse"].mean_tokens["crew"] == pytest.approx(3 / 5)
    # and nothing at 0
    assert means["sparse"].token_distribution["idle1"] == pytest.approx({1: 1.0})


def test_the_command_line_has_the_limits(tmp_path, capsys):
    path = tmp_path / "net.pnpro"
    write_net(philosophers(6), path)
    words = [
        "--limit",
        "70",
        "--limit-tree",
        "60",
        "--limit-structure",
        "50",
        "--limit-time",
        "9",
        "--limit-memory",
        "1",
    ]
    assert main(["analyse", str(path), "--json", *words]) == 1  # not all of it is decided
    data = json.loads(capsys.readouterr().out)
    expected = {"states": 70, "tree": 60, "structure": 50, "seconds": 9.0, "memory_bytes": 10**9}
    assert data["limits"] == expected
    for option in ("--limit-tree", "--limit-structure", "--limit-time", "--limit-memory"):
        assert main(["analyse", str(path), option, "0"]) == 2
        assert "%s 0: a limit must be greater than 0" % option in capsys.readouterr().err


def test_memory_that_there_is_not_is_a_limit_too():
    with pytest.raises(LimitError, match="raise --limit-memory"):
        working(lambda progress, cancel: bytearray(1 << 30), 1 << 28)


@pytest.mark.long
def test_an_interrupt_ends_the_work_at_once(tmp_path):
    path = tmp_path / "net.pnpro"
    write_net(philosophers(18), path)
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "gspn_framework_package",
            "analyse",
            str(path),
            "--limit",
            "100000000",
        ],
        # so that the second thread is that of the analysis
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        wait_for(lambda: _threads(process.pid) >= 2, 120, "the analysis to begin")
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60 * PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 130 and err.strip() == "gspn: interrupted"


def _threads(pid):
    with open("/proc/%d/status" % pid, encoding="ascii") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("Threads:"))


def _is_ended_by_an_interrupt(program, line):
    """See that an interrupt ends a program that has printed a line, and does not end by itself."""
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    try:
        assert process.stdout.readline() == line + "\n"
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60 * PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 130 and err.strip() == "gspn: interrupted"


def test_an_interrupt_does_not_wait_for_what_cannot_be_asked(tmp_path):
    program = (
        "import time\n"
        "from gspn_framework_package.cli.limits import working\n"
        "def work(progress, cancel):\n"
        "    print('working', flush=True)\n"
        "    time.sleep(600)\n"
        "working(work, 1 << 30)\n"
    )
    _is_ended_by_an_interrupt(program, "working")


@pytest.mark.long
def test_an_interrupt_does_not_wait_for_the_reading_of_a_file():
    program = (
        "import hashlib, sys\n"
        "from gspn_framework_package.cli.main import main\n"
        "from gspn_framework_package.formats import plan_file\n"
        "def read(*_, **__):\n"
        "    print('reading', flush=True)\n"
        # as a parser: compiled, and takes minutes
        "    hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)\n"
        "plan_file.read_net_or_plan = read\n"
        "sys.exit(main(['analyse', 'net']))\n"
    )
    _is_ended_by_an_interrupt(program, "reading")


def test_what_goes_wrong_in_the_work_is_reported_here():
    def fail(progress, cancel):
        assert threading.current_thread() is not threading.main_thread()
        raise LimitError("no")

    with pytest.raises(LimitError, match="no"):
        working(fail, 1 << 30)
