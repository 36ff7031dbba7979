"""The analysis by several ranks: it finds what one process finds."""

import json
import os
import shutil
import subprocess
import sys

import pytest
from generated_nets import bounded_nets
from hypothesis import given, settings
from hypothesis import strategies as st
from thread_ranks import on_ranks

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.distributed import DistributedAnalysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.benchmark.nets import kanban, philosophers
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import write_net
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import LimitError, RefusedError

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


# -- the command -----------------------------------------------------------------------------------


@pytest.fixture
def net_file(tmp_path):
    path = tmp_path / "net.pnml"
    write_net(kanban(2), path)
    return str(path)


def by_mpiexec(ranks, *words):
    pytest.importorskip("mpi4py")
    if not shutil.which("mpiexec"):
        pytest.skip("no mpiexec")
    environment = dict(os.environ, OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1")
    return subprocess.run(
        ["mpiexec", "--oversubscribe", "-n", str(ranks)]
        + [sys.executable, "-m", "gspn_framework_package", "analyse", *words, "--on", "mpi"],
        capture_output=True,
        text=True,
        env=environment,
        timeout=TIMEOUT,
    )


def test_mpiexec_counts_as_one_process_does(net_file, capsys):
    done = by_mpiexec(2, net_file, "--json")
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert main(["analyse", net_file, "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert all(data[key] == alone[key] for key in ("states", "bounds", "bounded"))
    assert [share["rank"] for share in data["ranks"]] == [0, 1]


def test_an_error_is_said_once(tmp_path):
    done = by_mpiexec(2, str(tmp_path / "none.pnml"))
    assert done.returncode == 2
    assert done.stderr.count("gspn: error") == 1 and "none.pnml" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    "words, said",
    [
        (["--at", "3"], "--on mpi does not take --at"),
        (["--engine", "numba"], "--on mpi does not take --engine"),
        (["--mean-time-to", "deadlock"], "--on mpi does not take --mean-time-to"),
    ],
)
def test_what_it_does_not_do_is_refused(net_file, capsys, words, said):
    pytest.importorskip("mpi4py")
    assert main(["analyse", net_file, "--on", "mpi", *words]) == 2
    assert said in capsys.readouterr().err


def test_mpi4py_that_is_not_installed_is_named(net_file, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    assert main(["analyse", net_file, "--on", "mpi"]) == 2
    assert "apt install python3-mpi4py openmpi-bin" in capsys.readouterr().err
