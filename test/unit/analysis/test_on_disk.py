"""State spaces on disk: the same counts as in memory, with however little memory."""

import errno
import json
import os

import numpy as np
import pytest
from generated_nets import bounded_nets
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import on_disk
from benchmarks.nets import FAMILIES
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.on_disk import answers
from gspn_framework_package.analysis.on_disk import scratch as scratch_module
from gspn_framework_package.analysis.on_disk.keys import KeyCode
from gspn_framework_package.analysis.on_disk.reach import cover, reach
from gspn_framework_package.analysis.on_disk.scratch import Scratch
from gspn_framework_package.analysis.on_disk.search import LEAST_MEMORY, search
from gspn_framework_package.analysis.on_disk.sorted_keys import (
    Budget,
    Writer,
    by_ranges,
)
from gspn_framework_package.analysis.report import Questions
from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.analysis.state_space.packing import Packing
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import write_net
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import CancelledError, LimitError, UsageError

LEAST = float(LEAST_MEMORY)


def as_in_memory(net, found):
    """Assert that a search on disk found what the exploration in memory finds."""
    space = explore(net)
    counts = found.counts
    assert (counts.states, counts.arcs) == (len(space), space.arcs)
    assert counts.vanishing == space.is_vanishing.sum()
    assert counts.dead == len(space.deadlocks)
    assert list(counts.bounds.values()) == space.markings().max(axis=0).tolist()
    firings = np.bincount(space.transitions, minlength=len(net.transitions))
    assert list(counts.firings.values()) == firings.tolist()
    assert reach(found, "deadlock", Watch()).number == counts.dead
    some = "'%s' >= 1" % net.places[-1].name
    assert reach(found, some, Watch()).number == space.holds(some).sum()
    dead = found.dead_marking()
    assert (dead is None) == (not counts.dead)
    if dead is not None:
        way, marking = dead
        assert len(way) == len(space.path_to(int(space.deadlocks[0])))
        here = tuple(net.initial_marking)
        for name in way:
            assert net.transition_number(name) in net.enabled(here)
            here = net.fire(here, net.transition_number(name))
        assert here == marking
        assert not net.enabled(here)


@pytest.mark.long
@given(net=bounded_nets(max_tokens=6))
@settings(derandomize=True, deadline=None, max_examples=60)
def test_the_least_memory_finds_what_is_found_in_memory(net):
    as_in_memory(net, search(net, LEAST))


@pytest.mark.parametrize(
    ("family", "size"), [("kanban", 2), ("fms", 2), ("polling", 5), ("philosophers", 8)]
)
def test_known_nets_are_as_in_memory(family, size):
    found = search(FAMILIES[family](size), 10 * LEAST)
    as_in_memory(found.net, found)
    assert found.scratch.peak >= 8 * len(found)
    found.scratch.close()
    assert found.scratch.used == 0


def wide(places):
    """A ring of places in which three tokens walk: its markings need several machine words."""
    builder = NetBuilder("wide")
    for i in range(places):
        builder.place("p%d" % i, tokens=3 * (i == 0))
    for i in range(places):
        builder.exponential(
            "t%d" % i, rate=1.0, inputs="p%d" % i, outputs="p%d" % ((i + 1) % places)
        )
    return builder.build()


@pytest.mark.long
@pytest.mark.parametrize("places", [26, 34])
def test_markings_of_several_words_are_found(places):
    as_in_memory(wide(places), search(wide(places), 2 * LEAST))


@pytest.mark.long
@given(data=st.data())
@settings(derandomize=True, deadline=None, max_examples=50)
def test_keys_keep_the_marking_and_are_sorted_after_a_firing(data):
    places = data.draw(st.sampled_from([3, 24, 60]))
    net = wide(places)
    packing = Packing(net, [2] * places)
    counts = st.lists(st.integers(0, 3), min_size=places, max_size=places)
    markings = np.array(data.draw(st.lists(counts, min_size=1, max_size=5)))
    code = KeyCode(packing)
    states = packing.pack_all(markings)
    keys = code.encode(states)
    assert (code.decode(keys) == states).all()
    p, q = data.draw(st.permutations(range(places)))[:2]
    moves = markings[(markings[:, p] > 0) & (markings[:, q] < 3)]
    before = code.encode(packing.pack_all(moves))
    moves[:, p] -= 1
    moves[:, q] += 1
    after = code.encode(packing.pack_all(moves))
    assert (np.sort(before) == before[np.argsort(after, kind="stable")]).all()


@given(
    values=st.lists(st.sets(st.integers(0, 400)), min_size=1, max_size=4),
    asked=st.sets(st.integers(0, 450)),
    most=st.integers(1, 100),
)
@settings(derandomize=True, deadline=None, max_examples=60)
def test_sequences_on_disk_are_searched_and_read_by_ranges(values, asked, most):
    scratch, budget = Scratch(), Budget(block=4, resident=80, together=16, expanded=64)
    runs = []
    for one in values:
        writer = Writer(scratch, budget, np.dtype(np.uint64))
        ordered = np.array(sorted(one), dtype=np.uint64)
        for begin in range(0, len(ordered), 7):
            writer.append(ordered[begin : begin + 7])
        runs.append(writer.finished())
    keys = np.array(sorted(asked), dtype=np.uint64)
    for one, run in zip(values, runs):
        positions, present = run.search(keys)
        assert positions[present].tolist() == [
            i for i, value in enumerate(sorted(one)) if value in asked
        ]
        assert (positions == np.searchsorted(sorted(one), keys)).all()
    largest = -1
    seen = [[] for _ in runs]
    for parts in by_ranges(runs, most):
        together = [int(key) for part in parts for key in part]
        assert min(together, default=largest + 1) > largest
        largest = max(together, default=largest)
        for one, part in zip(seen, parts):
            one += part.tolist()
    assert seen == [sorted(one) for one in values]


def test_a_field_that_is_too_narrow_is_widened():
    found = search(FAMILIES["kanban"](2), LEAST, bounds=[1] * 16)
    assert len(found) == 4600


def test_limits_and_cancel_stop_the_search():
    net = FAMILIES["kanban"](3)
    scratch = Scratch()
    with pytest.raises(LimitError, match="raise --limit"):
        search(net, LEAST, limit=1000)
    with pytest.raises(LimitError, match="--limit-time"):
        search(net, LEAST, seconds=0)
    with pytest.raises(CancelledError):
        search(net, LEAST, scratch=scratch, cancel=lambda: scratch.used > 10_000)
    with pytest.raises(UsageError, match="give at least"):
        search(net, 100)
    assert scratch.used == 0


@pytest.mark.long
def test_a_chain_that_is_cancelled_leaves_nothing():
    net, scratch = FAMILIES["kanban"](2), Scratch()

    def report(cancel=None, questions=Questions(structure=False)):  # noqa: B008 (immutable)
        _, data = answers.report_within(
            1e5,
            net,
            questions,
            scratch,
            lambda limits: Analysis(net, limits=limits),
            Limits(),
            cancel=cancel,
        )
        assert scratch.used == 0
        return data

    report(questions=Questions(structure=False, timing=False))
    counted = scratch.peak
    with pytest.raises(CancelledError, match="states of the chain"):
        report(lambda: scratch.used > counted + 100_000)
    assert scratch.used == 0
    report()
    solved = scratch.peak
    with pytest.raises(CancelledError, match="states in sweep"):
        report(lambda: scratch.used == solved)
    assert scratch.used == 0


def test_a_full_disk_is_said_before_and_while_it_fills(monkeypatch, tmp_path):
    net = FAMILIES["kanban"](2)
    usage = scratch_module.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(
        scratch_module.shutil, "disk_usage", lambda folder: usage._replace(free=80 << 20)
    )
    assert len(search(net, LEAST, scratch=Scratch(tmp_path))) == 4600
    monkeypatch.setattr(
        scratch_module.shutil, "disk_usage", lambda folder: usage._replace(free=60 << 20)
    )
    with pytest.raises(LimitError, match="0.0629 GB are free.*--scratch"):
        search(net, LEAST, scratch=Scratch(tmp_path))
    monkeypatch.undo()

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(LimitError, match="is full"):
        search(net, LEAST, scratch=Scratch(tmp_path))


@pytest.mark.long
def test_nothing_is_left_in_the_folder_even_while_it_works(tmp_path):
    seen = []
    found = search(
        FAMILIES["kanban"](2),
        LEAST,
        scratch=Scratch(tmp_path),
        cancel=lambda: bool(seen.append(list(tmp_path.iterdir()))),
    )
    assert found.scratch.peak > 10_000
    assert not any(seen)


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(UsageError, match="cannot create a temporary file"):
        Scratch(tmp_path / "nowhere")


def analysed(capsys, *arguments):
    """The exit code, the output and the errors of ``gspn analyse``."""
    code = main(["analyse", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(name="kanban")
def kanban_file(tmp_path):
    """A file with a net of 4,600 markings."""
    write_net(FAMILIES["kanban"](2), tmp_path / "kanban.pnml")
    return str(tmp_path / "kanban.pnml")


@pytest.mark.long
def test_the_command_answers_on_disk_what_it_can(kanban, tmp_path, capsys):
    code, out, _ = analysed(
        capsys, kanban, "--json", "--memory", "100KB", "--scratch", str(tmp_path)
    )
    data = json.loads(out)
    _, out, _ = analysed(capsys, kanban, "--json")
    whole = json.loads(out)
    assert code == 0
    assert data["engine"] == "disk"
    assert data["scratch"] == str(tmp_path)
    assert data["scratch_bytes"] > 8 * 4600
    same = ("states", "bounds", "bounded", "deadlocks", "k_safe", "dead_transitions")
    assert {key: data[key] for key in same} == {key: whole[key] for key in same}
    assert set(whole) <= set(data)
    assert all(data["undecided"][key] for key in whole if data[key] is None and whole[key])
    assert set(data["steady_state"]) == set(whole["steady_state"])
    assert data["steady_state"]["throughput"] == pytest.approx(whole["steady_state"]["throughput"])
    _, out, _ = analysed(capsys, kanban, "--memory", "100KB", "--no-structure")
    assert "states: 4,600 (4,600 tangible" in out
    assert "on disk: at most" in out
    assert "steady state (" in out


@pytest.mark.long
def test_questions_are_answered_on_disk_as_in_memory(kanban, capsys):
    asked = ["--no-structure", "--json", "--reward", "machine1=2", "--reward", "enter=3"]
    for condition in ("machine1 == 2 and out4 == 1", "machine1 == 3", "deadlock", "out1 == 2"):
        asked += ["--reach", condition]
    asked += ["--cover", "machine1=1,machine4=2", "--cover", "machine1=3"]
    _, out, _ = analysed(capsys, kanban, *asked)
    whole = json.loads(out)
    _, out, _ = analysed(capsys, kanban, *asked, "--memory", "100KB")
    data = json.loads(out)
    assert data["engine"] == "disk"
    assert data["steady_state"]["reward"] == pytest.approx(whole["steady_state"]["reward"])
    for key in ("reach", "cover"):
        for here, there in zip(data[key], whole[key]):
            for name in ("condition", "reachable", "coverable", "count"):
                assert here.get(name) == there.get(name)
            # there may be several shortest ways
            assert len(here["witness"] or ()) == len(there["witness"] or ())
    assert [found["reachable"] for found in data["reach"]] == [True, False, False, True]


def test_a_witness_on_disk_can_be_fired_and_holds():
    net = FAMILIES["fms"](2)
    space = search(net, 10 * LEAST)
    wanted = {net.places[3].name: 2}
    found = cover(space, wanted, Watch())
    here = tuple(net.initial_marking)
    for step in found.witness:
        assert net.transition_number(step.transition) in net.enabled(here)
        here = net.fire(here, net.transition_number(step.transition))
        assert net.named(here, zeros=False) == step.marking
    assert here[3] >= 2


@pytest.mark.parametrize(
    ("question", "says"),
    [
        (["--reach", "nowhere == 1"], "nowhere"),
        (["--cover", "nowhere=1"], "nowhere"),
        (["--reward", "nowhere=1"], "nowhere"),
    ],
)
def test_a_mistake_in_a_question_is_found_before_the_search(
    kanban, capsys, monkeypatch, question, says
):
    monkeypatch.setattr(answers, "search", None)
    code, _, errors = analysed(capsys, kanban, "--memory", "100KB", *question)
    assert code == 2
    assert says in errors


def test_too_little_memory_for_the_steady_state_is_said(kanban, capsys):
    _, out, _ = analysed(capsys, kanban, "--json", "--no-structure", "--memory", "50KB")
    data = json.loads(out)
    assert data["states"]["total"] == 4600
    assert data["steady_state"] is None
    assert "raise --memory" in data["undecided"]["steady_state"]


def test_the_command_stays_in_memory_if_that_is_enough(kanban, capsys):
    _, out, _ = analysed(capsys, kanban, "--json", "--memory", "10MB")
    data = json.loads(out)
    assert data["engine"] != "disk"
    assert data["live"]
    _, out, _ = analysed(capsys, kanban, "--json", "--memory", "100KB", "--limit", "50")
    assert json.loads(out)["live"] is None


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--memory", "much"], "expected a size"),
        (["--memory", "100"], "at least 17 KB"),
        (["--memory", "1GB", "--limit-memory", "1"], "exclude each other"),
        (["--scratch", "/tmp"], "requires --memory"),
        (["--memory", "1GB", "--scratch", "/nowhere"], "cannot create a temporary file"),
    ],
)
def test_the_command_refuses_what_makes_no_sense(kanban, capsys, arguments, says):
    code, _, errors = analysed(capsys, kanban, *arguments)
    assert code == 2
    assert says in errors


def test_a_plan_is_not_taken(capsys):
    code, _, errors = analysed(capsys, "plans/rendezvous", "--memory", "1GB")
    assert code == 2
    assert "--only-net" in errors


def test_a_net_without_bounds_never_goes_on_disk(tmp_path, capsys):
    builder = NetBuilder("grows").place("p", tokens=1).place("q").place("r")
    builder.exponential("t", rate=1.0, inputs="p", outputs=["p", "q"])
    builder.exponential("u", rate=1.0, inputs="q", outputs="r")
    builder.exponential("v", rate=1.0, inputs="r", outputs="q")
    write_net(builder.build(), tmp_path / "grows.pnml")
    code, out, _ = analysed(capsys, str(tmp_path / "grows.pnml"), "--json", "--memory", "100KB")
    data = json.loads(out)
    assert code == 1
    assert data["bounded"] is False
    assert "scratch_bytes" not in data


@pytest.mark.long
def test_the_benchmark_compares_with_memory(capsys):
    assert on_disk.main(["--sizes", "2", "--steady", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["nets"]
    assert row["same"] is True
    assert row["disk"]["states"] == 4600
    assert row["disk"]["rates"] == 28120
    assert row["disk"]["peak_mb"] > 0
