"""The analysis by several ranks: it finds what one process finds."""

import importlib.util
import json
import os
import pty
import shutil
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from generated_nets import bounded_nets
from hypothesis import given, settings
from hypothesis import strategies as st
from steady_answers import assert_answers_of
from thread_ranks import on_ranks

from benchmarks import distributed as benchmark
from benchmarks.nets import kanban, philosophers
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.distributed import DistributedAnalysis
from gspn_framework_package.analysis.distributed.growth import growth
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.report import Questions, report
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import write_net
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import LimitError, RefusedError

ROOT = Path(__file__).resolve().parents[3]
TIMEOUT = 120


def counts_alone(net):
    analysis = Analysis(net)
    space = analysis.space
    vanishing = int(space.is_vanishing.sum())
    return (
        {
            "total": len(space),
            "tangible": len(space) - vanishing,
            "vanishing": vanishing,
            "arcs": space.arcs,
        },
        dict(zip((p.name for p in net.places), space.store.largest())),
        len(space.deadlocks),
    )


def counts_together(net, size, **limits):
    def work(ranks):
        analysis = DistributedAnalysis(net, ranks, limits=Limits(**limits))
        return (
            analysis.counts(),
            analysis.bounds(),
            analysis.deadlocks()["count"],
        ), analysis.shares()

    found = on_ranks(size, work)
    assert all(answers == found[0] for answers in found)
    answers, shares = found[0]
    assert sum(share["states"] for share in shares) == answers[0]["total"]
    return answers


@settings(derandomize=True, deadline=None, max_examples=30)
@given(bounded_nets(), st.integers(1, 4))
def test_any_number_of_ranks_counts_as_one_process_does(net, size):
    assert counts_together(net, size) == counts_alone(net)


@pytest.mark.parametrize("net", [kanban(2), philosophers(4)], ids=["kanban", "philosophers"])
def test_nets_from_the_literature_are_counted(net):
    assert counts_together(net, 3) == counts_alone(net)


def test_the_states_are_divided_evenly():
    shares = on_ranks(4, lambda ranks: DistributedAnalysis(kanban(2), ranks).shares())[0]
    assert all(1000 < share["states"] < 1300 for share in shares), shares


def test_a_deadlock_is_shown():
    found = on_ranks(3, lambda ranks: DistributedAnalysis(philosophers(4), ranks).deadlocks())[0]
    assert found == {"count": 1, "marking": {"left%d" % i: 1 for i in range(1, 5)}}


def test_fields_that_are_too_narrow_are_widened_by_all():
    # no invariant bounds the place, so that its field begins narrow
    net = (
        NetBuilder("filling")
        .place("left", tokens=90)
        .place("filled")
        .exponential("fill", inputs="left", outputs={"filled": 2})
        .exponential("empty", inputs={"filled": 3}, outputs="left")
        .build()
    )
    assert counts_together(net, 2) == counts_alone(net)


def counting_and_open():
    """A net with a place that only counts, and one whose queue grows without end."""
    counting = (
        NetBuilder("counting")
        .place("a", tokens=1)
        .place("b")
        .place("done")
        .exponential("x", inputs="a", outputs=["b", "done"])
        .exponential("y", rate=2.0, inputs="b", outputs="a")
    )
    growing = (
        NetBuilder("open")
        .place("on", tokens=1)
        .place("queue")
        .exponential("come", inputs="on", outputs=["on", "queue"])
        .exponential("go", rate=2.0, inputs="queue")
    )
    return counting.build(), growing.build()


def test_a_net_that_grows_is_judged_before_it_is_visited():
    counting, growing = counting_and_open()
    found = growth(counting, Limits())
    assert (found.left_out, found.bounded, found.left_out_bounds) == (
        ("done",),
        False,
        {"done": "infinite"},
    )
    assert [place.name for place in found.net.places] == ["a", "b"] and found.report is None
    assert counts_together(found.net, 2)[0]["total"] == 2
    found = growth(growing, Limits())
    assert found.report["bounds"] == {"on": 1, "queue": "infinite"}
    assert found.report == report(Analysis(growing, limit=20_000), Questions(structure=False))
    assert growth(kanban(2), Limits()).net == kanban(2)


def test_limits_end_all_ranks_with_one_error():
    for limits, option in (({"states": 1000}, "--limit,"), ({"memory": 10_000}, "--limit-memory")):
        with pytest.raises(LimitError, match=option):
            counts_together(kanban(2), 2, **limits)


def test_a_net_of_thousands_of_places_is_refused():
    net = NetBuilder("long")
    for i in range(2000):
        net.place("p%d" % i, tokens=not i)
    for i in range(2000):
        net.exponential("t%d" % i, inputs="p%d" % i, outputs="p%d" % ((i + 1) % 2000))
    with pytest.raises(RefusedError, match="leave --on out"):
        on_ranks(2, lambda ranks: DistributedAnalysis(net.build(), ranks))


# -- the steady state ------------------------------------------------------------------------------


def steady_together(net, size, direct):
    found = on_ranks(size, lambda ranks: DistributedAnalysis(net, ranks).steady_state(direct))
    assert all(answers == found[0] for answers in found)
    return found[0]


def assert_steady_as_alone(net, size, direct):
    analysis = Analysis(net)
    found = steady_together(net, size, direct)
    assert_answers_of(analysis, found)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(bounded_nets(), st.integers(1, 4), st.sampled_from([0, 2000]))
def test_any_number_of_ranks_finds_the_steady_state_of_one_process(net, size, direct):
    analysis = Analysis(net)
    try:
        several = len(analysis.steady.components) > 1
    except RefusedError as refusal:
        with pytest.raises(RefusedError) as told:
            steady_together(net, size, direct)
        # the first state with the fault is another one
        assert told.value.message.split(" from ")[0] == refusal.message.split(" from ")[0]
        return
    if several:
        with pytest.raises(RefusedError, match="several recurrent classes"):
            steady_together(net, size, direct)
        return
    assert_steady_as_alone(net, size, direct)


@pytest.mark.parametrize("size", [1, 4])
def test_sweeps_of_all_ranks_solve_a_net_from_the_literature(size):
    assert_steady_as_alone(kanban(2), size, 0)


def patrol(robots):
    plan = read_plan(str(ROOT / "plans" / "patrol")).for_robots(robots)
    return plan.net


def test_sweeps_of_all_ranks_solve_a_net_with_immediate_transitions():
    net = patrol(3)
    assert any(not transition.timed for transition in net.transitions)
    assert_steady_as_alone(net, 3, 0)


def test_states_that_are_left_for_good_take_no_time():
    # from two transient states into a cycle of three
    net = NetBuilder("leaving")
    for i in range(5):
        net.place("p%d" % i, tokens=not i)
    for i, j in ((0, 1), (1, 2), (2, 3), (3, 4), (4, 2)):
        net.exponential("t%d" % i, rate=i + 1.0, inputs="p%d" % i, outputs="p%d" % j)
    for size in (1, 2, 3):
        assert_steady_as_alone(net.build(), size, 0)


# -- the command -----------------------------------------------------------------------------------


@pytest.fixture
def net_file(tmp_path):
    path = tmp_path / "net.pnml"
    write_net(kanban(2), path)  # 4600 states: more than each rank would solve alone
    return str(path)


def need_mpi():
    """Skip the test where MPI is not installed; on Debian 12, prepare.sh installs it."""
    missing = not shutil.which("mpiexec") or not importlib.util.find_spec("mpi4py")
    if missing and sys.version_info < (3, 11):
        pytest.skip("no MPI for this Python")
    assert not missing, "scripts/prepare.sh installs openmpi-bin and python3-mpi4py"


def by_mpiexec_started(ranks, *words):
    need_mpi()
    environment = dict(os.environ, OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1")
    return subprocess.Popen(
        ["mpiexec", "--oversubscribe", "-n", str(ranks)]
        + [sys.executable, "-m", "gspn_framework_package", "analyse", *words, "--on", "mpi"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        universal_newlines=True,
        env=environment,
    )


def by_mpiexec(ranks, *words):
    with by_mpiexec_started(ranks, *words) as started:
        try:
            output, errors = started.communicate(timeout=TIMEOUT)
        finally:
            started.kill()
    return started.returncode, output, errors


def test_mpiexec_answers_as_one_process_does(net_file, capsys):
    code, output, errors = by_mpiexec(2, net_file, "--json")
    assert code == 0, errors
    data = json.loads(output)
    assert main(["analyse", net_file, "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert all(data[key] == alone[key] for key in ("states", "bounds", "bounded"))
    steady, expected = data["steady_state"], alone["steady_state"]
    assert steady["throughput"] == pytest.approx(expected["throughput"], abs=1e-9)
    assert steady["mean_tokens"] == pytest.approx(expected["mean_tokens"], abs=1e-9)
    assert steady.keys() == expected.keys()
    assert [share["rank"] for share in data["ranks"]] == [0, 1]


def test_mpiexec_answers_for_nets_that_grow_as_one_process_does(tmp_path, capsys):
    for net in counting_and_open():
        path = tmp_path / ("%s.pnml" % net.name)
        write_net(net, path)
        code, output, errors = by_mpiexec(2, str(path), "--json")
        assert code == (net.name != "counting"), errors
        data = json.loads(output)
        assert main(["analyse", str(path), "--json"]) == code
        alone = json.loads(capsys.readouterr().out)
        for key in ("states", "bounded", "bounds", "left_out"):
            assert data[key] == alone[key]
        for key, reason in data["undecided"].items():
            assert reason == alone["undecided"][key]
        if net.name == "counting":
            steady, expected = data["steady_state"], alone["steady_state"]
            assert steady["throughput"] == pytest.approx(expected["throughput"], abs=1e-9)
        else:
            assert "queue can grow without end" in data["undecided"]["steady_state"]


def test_a_rank_that_is_killed_ends_all(tmp_path):
    path = tmp_path / "large.pnml"
    write_net(kanban(6), path)
    with by_mpiexec_started(2, str(path)) as started:
        mine = psutil.Process(started.pid)
        deadline = time.monotonic() + TIMEOUT
        ranks = []
        while len(ranks) < 2:
            assert time.monotonic() < deadline and started.poll() is None
            ranks = [p for p in mine.children(recursive=True) if "analyse" in cmdline(p)]
            time.sleep(0.05)
        ranks[1].kill()
        _, errors = started.communicate(timeout=TIMEOUT)
    assert started.returncode != 0
    assert "exited on signal 9" in errors and "Traceback" not in errors
    while not all(ended(rank) for rank in ranks):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def ended(process):
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def cmdline(process):
    try:
        return process.cmdline()
    except psutil.Error:
        return []


def test_an_error_is_said_once(tmp_path):
    code, _, errors = by_mpiexec(2, str(tmp_path / "none.pnml"))
    assert code == 2
    assert errors.count("gspn: error") == 1 and "none.pnml" in errors
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    "words, said",
    [
        (["--at", "3"], "--on mpi does not take --at"),
        (["--engine", "numba"], "--on mpi does not take --engine"),
        (["--mean-time-to", "deadlock"], "--on mpi does not take --mean-time-to"),
    ],
)
def test_what_it_does_not_do_is_refused(net_file, capsys, words, said):
    need_mpi()
    assert main(["analyse", net_file, "--on", "mpi", *words]) == 2
    assert said in capsys.readouterr().err


def test_mpi4py_that_is_not_installed_is_named(net_file, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    assert main(["analyse", net_file, "--on", "mpi"]) == 2
    assert "apt install python3-mpi4py openmpi-bin" in capsys.readouterr().err


def test_nothing_is_written_behind_the_output():
    # the standard output of a rank is a terminal of mpiexec, where numba would reset the colours
    pytest.importorskip("numba")
    mine, theirs = pty.openpty()
    code = "from %s import _load_libraries; _load_libraries()" % benchmark.__name__
    subprocess.run([sys.executable, "-c", code], stdout=theirs, check=True, timeout=TIMEOUT)
    os.close(theirs)
    try:
        written = os.read(mine, 100)
    except OSError:  # how Linux tells that nothing comes any more
        written = b""
    os.close(mine)
    assert written == b""


# -- the benchmark ---------------------------------------------------------------------------------


def test_the_benchmark_compares_ranks_with_one_process(capsys):
    need_mpi()
    assert benchmark.main(["--sizes", "1", "--ranks", "1", "2", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [row["ranks"] for row in found["rows"]] == [0, 1, 2]
    assert all(row["counts"][0] == 160 and row["same"] for row in found["rows"])
    assert all(row["peak_mb"] >= 0 and row["steady_seconds"] > 0 for row in found["rows"])
    assert "mpi4py" in found["machine"]


@pytest.mark.parametrize(
    "wrong", [{"counts": [160, 617]}, {"answers": {"t:good1": 0.25 + 2e-9}}, {}]
)
def test_the_benchmark_fails_where_ranks_find_something_else(capsys, monkeypatch, wrong):
    def measured(_, ranks):
        found = {
            "counts": [160, 616],
            "answers": {"t:good1": 0.25},
            "peak_mb": 90.0 / max(ranks, 1),
        }
        found.update(
            seconds=1.0, cpu_seconds=1.0, explore_seconds=0.5, steady_seconds=0.5, empty_mb=80.0
        )
        return {**found, **(wrong if ranks == 2 else {})}

    monkeypatch.setattr(benchmark, "measured", measured)
    assert benchmark.main(["--sizes", "1", "--ranks", "1", "2"]) == (1 if wrong else 0)
    table = capsys.readouterr().out
    assert "| kanban 1 |     2 ranks |" in table
