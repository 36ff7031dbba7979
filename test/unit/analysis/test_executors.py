"""Executors: the same results in this process, in processes and on a Dask cluster, whatever dies."""

import os
import platform
import random
import signal
import socket
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from waiting import wait_for

from gspn_framework_package.analysis.decisions.aims import Objective, Request
from gspn_framework_package.analysis.decisions.rollout import improve
from gspn_framework_package.analysis.executors import (
    LocalExecutor,
    WorkItem,
    Workload,
    dask_cluster,
    open_executor,
    remote,
)
from gspn_framework_package.analysis.executors.dask_cluster import DaskExecutor
from gspn_framework_package.analysis.executors.processes import ProcessExecutor
from gspn_framework_package.analysis.fitting import fit_plan
from gspn_framework_package.analysis.monitoring.prediction import Span, predict
from gspn_framework_package.analysis.simulation import simulate
from gspn_framework_package.analysis.simulation.against import compare_plans
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.attempt import Attempt
from gspn_framework_package.model.duration import Duration, Evidence
from gspn_framework_package.model.errors import (
    CancelledError,
    RefusedError,
    UsageError,
    WorkersError,
)
from gspn_framework_package.model.policy import Policy

PLANS = Path(__file__).parents[3] / "plans"


def told(number):
    return number


def squared(offset, piece, watch):
    return offset + piece**2, os.getpid()


def refuse(offset, piece, watch):
    raise RefusedError("no %d" % piece, element="task", hint="take another")


def die_once(folder, piece, watch):
    """Kill the worker over the task 2, the first time."""
    marker = Path(folder) / "died"
    if piece == 2 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return piece * 10


def die(folder, piece, watch):
    os.kill(os.getpid(), signal.SIGKILL)


def work_on_and_on(folder, piece, watch):
    marker = Path(folder) / str(os.getpid())
    marker.touch()
    try:
        while True:
            watch.step("rounds", 0)
    finally:
        marker.with_suffix(".stopped").touch()


def is_alive(pid):
    try:
        return Path("/proc/%d/stat" % pid).read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=":0",
        local_directory=str(tmp_path_factory.mktemp("dask")),
    ) as found:
        yield found.scheduler_address


@pytest.fixture(scope="module")
def dask(cluster):
    with open_executor("dask:" + cluster) as executor:
        yield executor


@pytest.fixture(scope="module")
def processes():
    with open_executor("processes:2") as executor:
        yield executor


@pytest.fixture(params=["processes", "dask"])
def executor(request):
    return request.getfixturevalue(request.param)


@pytest.mark.parametrize("timing", ["run", "net"])
def test_results_are_those_of_this_process_to_the_last_bit(executor, timing):
    plan = read_plan(str(PLANS / "patrol"))
    asked = {"time": 2.0, "replications": 620, "seed": 7, "timing": timing, "samples": True}
    here, there = simulate(plan, **asked), simulate(plan, on=executor, **asked)
    assert there.to_json() == here.to_json()
    for ours, theirs in zip(here.samples, there.samples):
        assert ours.tobytes() == theirs.tobytes()


def test_a_wanted_precision_takes_the_same_runs(processes):
    plan = read_plan(str(PLANS / "tokens"))
    asked = {"time": 5.0, "precision": 0.2, "seed": 1}
    assert simulate(plan, on=processes, **asked) == simulate(plan, **asked)


def test_one_long_run_is_one_task(processes):
    plan = read_plan(str(PLANS / "tokens"))
    asked = {"time": 50.0, "batches": 5}
    assert simulate(plan, on=processes, **asked) == simulate(plan, **asked)


def test_a_fit_is_the_same(processes):
    plan = read_plan(str(PLANS / "tokens"))
    source = random.Random(5)
    seen = []
    for place in plan.action_places[:3]:
        for n in range(40):
            took = source.gammavariate(4.0, 0.5)
            seen.append(Attempt("r", place, n, 0, n * 10.0, n * 10.0 + took, n % 9 > 0))
    here = fit_plan(plan, seen, samples=20)
    there = fit_plan(plan, seen, samples=20, on=processes)
    assert there.to_json() == here.to_json()
    assert sum(fit.test is not None for fit in here.places.values()) >= 2


@pytest.mark.long
def test_a_prediction_is_the_same(processes):
    plan = read_plan(str(PLANS / "tokens"))
    learned = replace(
        plan,
        durations={p: Duration.gamma(4.0, 1.0) for p in plan.action_places},
        evidence={("durations", p): Evidence(9, ("a.jsonl",)) for p in plan.action_places},
    )
    for subject in (plan, learned):
        spans = [Span(subject, 3.0), Span(subject, 5.0)]
        here = predict(spans, replications=120, seed=2)
        there = predict(spans, replications=120, seed=2, on=processes)
        assert here.size == 120
        for ours, theirs in zip(here, there):
            assert ours.tobytes() == theirs.tobytes()


@pytest.mark.long
def test_a_comparison_of_two_plans_is_the_same(processes):
    plan = read_plan(str(PLANS / "tokens"))
    other = plan.with_policy(Policy())
    objective = Objective.long_run({"t1": 1.0})
    for asked in ({"replications": 30}, {"precision": 0.2, "time": 20.0}):
        here = compare_plans(plan, other, objective, seconds=None, **asked)
        there = compare_plans(plan, other, objective, seconds=None, on=processes, **asked)
        assert there.to_json() == {**here.to_json(), "needed": there.needed}  # with a time


@pytest.mark.long
def test_a_policy_is_improved_in_the_same_way(processes):
    plan = read_plan(str(PLANS / "tokens"))
    request = Request(Objective.long_run({"t1": 1.0}))
    asked = {"seconds": None, "rounds": 1, "visits": 60, "pairs": 20}
    here = improve(plan, request, **asked)
    there = improve(plan, request, on=processes, **asked)
    assert (there.policy, there.old, there.notes) == (here.policy, here.old, here.notes)
    assert (there.new, there.markings) == (here.new, here.markings)


def test_results_come_with_their_number_and_all_workers_help(executor):
    tasks = [WorkItem(Workload(told, squared, offset), n) for offset in (0, 100) for n in range(20)]
    found = executor.ordered(tasks, "squares", Watch())
    assert [value for value, _ in found] == [o + n**2 for o in (0, 100) for n in range(20)]
    assert os.getpid() not in {pid for _, pid in found}


def test_progress_counts_what_is_done(executor):
    seen = []
    tasks = [WorkItem(Workload(told, squared, 0), n, size=5) for n in range(4)]
    watch = Watch(lambda what, count, _: seen.append((what, count)), interval=0.0)
    executor.ordered(tasks, "runs", watch)
    assert seen[-1] == ("runs", 20)


def test_what_a_task_raises_arrives(executor):
    with pytest.raises(RefusedError) as raised:
        executor.ordered([WorkItem(Workload(told, refuse, 0), 3)], "tasks", Watch())
    assert str(raised.value) == "task: no 3 (take another)"


@pytest.mark.long
def test_the_task_of_a_killed_worker_is_done_again(executor, tmp_path):
    tasks = [WorkItem(Workload(told, die_once, str(tmp_path)), n) for n in range(12)]
    assert executor.ordered(tasks, "tasks", Watch()) == [10 * n for n in range(12)]
    assert (tmp_path / "died").exists()


@pytest.mark.long
def test_a_task_that_kills_every_worker_is_given_up(monkeypatch):
    monkeypatch.setattr(remote, "_MOST_DEATHS", 1)
    with ProcessExecutor(1) as executor, pytest.raises(WorkersError, match="died 2 times"):
        executor.ordered([WorkItem(Workload(told, die, ""), 0)], "tasks", Watch())


def test_cancel_reaches_the_workers(executor, tmp_path):
    tasks = [WorkItem(Workload(told, work_on_and_on, str(tmp_path)), n) for n in range(6)]

    def begun():
        return [path for path in tmp_path.iterdir() if not path.suffix]

    def stopped(path):
        return path.with_suffix(".stopped").exists() or not is_alive(int(path.name))

    with pytest.raises(CancelledError):
        executor.ordered(tasks, "tasks", Watch(cancel=lambda: len(begun()) == 2))
    wait_for(lambda: all(map(stopped, begun())), 60)
    after = executor.ordered([WorkItem(Workload(told, squared, 0), 3)], "tasks", Watch())
    assert after[0][0] == 9


@pytest.mark.long
def test_workers_end_with_the_process_that_started_them(tmp_path):
    script = (
        "from gspn_framework_package.analysis.executors import *\n"
        "from gspn_framework_package.analysis.watch import Watch\n"
        "from test_executors import *\n"
        "if __name__ == '__main__':\n"
        "    tasks = [WorkItem(Workload(told, work_on_and_on, %r), 0)]\n"
        "    ProcessExecutor(1).ordered(tasks, 'tasks', Watch())\n" % str(tmp_path)
    )
    (tmp_path / "begin.py").write_text(script)
    paths = os.pathsep.join(sys.path)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "begin.py")], env={**os.environ, "PYTHONPATH": paths}
    )

    def workers():
        return [int(path.name) for path in tmp_path.iterdir() if path.name.isdecimal()]

    try:
        wait_for(workers, 60)
    finally:
        process.kill()
        process.wait()
    wait_for(lambda: not any(map(is_alive, workers())), 60)


@pytest.fixture
def other_python(monkeypatch):
    monkeypatch.setattr(platform, "python_version_tuple", lambda: ("3", "1", "0"))
    remote.versions.cache_clear()
    yield
    remote.versions.cache_clear()


@pytest.mark.usefixtures("other_python")
def test_a_worker_of_another_version_is_refused(dask, cluster):
    python = "%d.%d" % sys.version_info[:2]
    with pytest.raises(WorkersError, match="the worker tcp://.* has Python %s instead" % python):
        DaskExecutor(cluster)
    # the same of one that came later
    with pytest.raises(WorkersError, match="a worker has Python %s instead of 3.1" % python):
        dask.ordered([WorkItem(Workload(told, squared, 0), 3)], "tasks", Watch())


def test_dask_that_is_not_installed_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(WorkersError, match=r'pip install "dask\[distributed\]"'):
        open_executor("dask:tcp://localhost:8786")


def test_an_address_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setattr(dask_cluster, "_PATIENCE", 0.5)
    with closing(socket.socket()) as port:
        port.bind(("localhost", 0))
        address = "tcp://localhost:%d" % port.getsockname()[1]
        with pytest.raises(WorkersError, match="no Dask scheduler answers at " + address):
            open_executor("dask:" + address)


def test_a_scheduler_without_workers_is_named(monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(dask_cluster, "_PATIENCE", 0.5)
    with LocalCluster(n_workers=0, dashboard_address=":0") as empty, pytest.raises(
        WorkersError, match="has no workers .*dask worker"
    ):
        open_executor("dask:" + empty.scheduler_address)


@pytest.mark.parametrize("text", ["", "here", "processes:", "processes:0", "processes:x", "dask:"])
def test_what_names_no_executor_is_refused(text):
    with pytest.raises(UsageError, match="--on"):
        open_executor(text)


@pytest.mark.long
def test_local_needs_nothing():
    with open_executor("local") as executor:
        assert isinstance(executor, LocalExecutor)
        assert executor.workers == 1


@pytest.mark.long
def test_the_command_line_chooses(cluster, capsys):
    words = ["simulate", str(PLANS / "tokens"), "--time", "3", "--replications", "60", "--json"]
    printed = []
    for on in ("local", "dask:" + cluster):
        assert main([*words, "--on", on]) == 0
        printed.append(capsys.readouterr().out)
    assert printed[0] == printed[1]
    assert main([*words, "--on", "cloud"]) == 2
    assert "take local, processes, processes:N or dask:ADDRESS" in capsys.readouterr().err
