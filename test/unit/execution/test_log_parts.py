"""Logs of teams and runs that adopted another plan are read part by part."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, List

import pytest
from deployed_log import write_deployed_log
from logged_runs import Story, ring, save_logs

from agreement.plans import make_plan as team_plan
from agreement.world import World
from gspn_framework_package.cli.main import main
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.history import read_run, runs_of_logs
from gspn_framework_package.execution.history_run import HistoryRun, PlanNames
from gspn_framework_package.execution.log_parts import log_parts
from gspn_framework_package.execution.logged_attempts import gather
from gspn_framework_package.execution.plan_change import stage_of
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.errors import LogError

TOUR, MEET, TOKENS, CROWD, ERRANDS, ROUNDS = range(6)


def deployed_team(folder: Path, kind: int, partial: bool, crash: bool) -> List[str]:
    """The logs of a team that adopts another policy's plan after about a second."""
    world = World(team_plan(kind, 3, partial, 0.0, 0.0, False), 5)
    nodes = list(world.nodes.values())
    for node in nodes:
        node.start()
    world.run(1.0)
    new = replace(nodes[0].plan, name="new", seed=9)
    world.operator(stage_of(new, {}), nodes[0])
    assert world.run(2.0, lambda: len(_votes(nodes)) == 3)
    world.operator(log_entries.Adopt(-1), nodes[1])
    assert world.run(3.0, lambda: all(_adopted(node) for node in nodes))
    if crash:
        nodes[2].crash()
        world.run(3.5)
        nodes[2].start()
    world.run(5.0)
    return save_logs(world, folder)


def _votes(nodes: List[Any]) -> Dict[str, Any]:
    staged = nodes[0].replica.ledger.state.staged
    return {} if staged is None else staged.votes


def _adopted(node: Any) -> bool:
    return node.replica.ledger.state.adopted is not None


@pytest.mark.parametrize(
    ("kind", "partial", "crash"),
    [(TOUR, True, False), (TOKENS, False, True), (TOUR, True, True), (ERRANDS, False, False)],
)
def test_the_logs_of_a_team_after_a_deploy(tmp_path, kind, partial, crash) -> None:
    paths = deployed_team(tmp_path, kind, partial, crash)
    found = gather(paths)
    keys = [(a.robot, a.visit, a.attempt) for a in found.attempts]
    # the deploy cuts off what was running, and its rest is not an attempt
    assert len(keys) == len(set(keys))
    assert all(a.duration >= 0 for a in found.attempts) and len(found.runs) == 2
    groups = runs_of_logs(paths)
    assert {part.stage for part in groups[0]} == {0} and {p.stage for p in groups[1]} == {1}
    runs = [read_run(group) for group in groups]
    assert [run.plan.name for run in runs][1] == "new"
    first, second = runs
    assert len(second.roster) == 3
    assert second.began == pytest.approx(first.began + first.seconds, abs=0.5)
    firings: Counter = Counter()
    for run in runs:
        assert sum(run.firings.values()) > 5
        firings.update(run.firings)
        names = PlanNames.between(run.plan, run.plan, {})
        played = HistoryRun(run.plan, run, names).play(2)
        assert sum(played.firings[-1]) > 0.5 * sum(run.firings.values())
        assert played.recorded > played.drawn


@pytest.mark.long
def test_the_verbs_read_them(tmp_path, capsys) -> None:
    logs = deployed_team(tmp_path, TOUR, True, False)
    folder = tmp_path / "plan"
    folder.mkdir()
    plan = folder / "plan.json"
    plan.write_text(json.dumps(plan_to_json(team_plan(TOUR, 3, True, 0.0, 0.0, False))))
    new = str(folder / "fitted.json")
    assert main(["fit", str(plan), *logs, "-o", new, "--json"]) == 0
    fitted = json.loads(capsys.readouterr().out)
    assert any(found["n"] > 10 for found in fitted["places"].values())
    assert main(["compare", new, *logs, "--replay", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["runs"] == 2 and found["worse"] == []
    assert found["firings"]["old"] == pytest.approx(found["firings"]["recorded"], rel=0.2)
    assert main(["compare", new, *logs, "--replications", "40", "--json"]) in (0, 1)
    names = [run["name"] for run in json.loads(capsys.readouterr().out)["runs"]]
    assert len(names) == 2 and names[1].endswith(", plan 2")


def test_parts_of_another_net_are_left_out(tmp_path) -> None:
    path = str(tmp_path / "log.jsonl")
    four, five, again = write_deployed_log(path, 60)
    assert [(part.stage, part.plan.name) for part in log_parts(path)] == [
        (0, "four"),
        (1, "five"),
        (2, "again"),
    ]
    found = gather([path])  # that of the last plan
    assert found.plan.net.place_index.keys() == five.net.place_index.keys()
    assert len(found.runs) == 2 and {a.place for a in found.attempts} <= set("EXDBA")
    assert len(found.notes) == 1 and "plan 1: left out, its net differs" in found.notes[0]
    earlier = gather([path], four)
    assert {a.place for a in earlier.attempts} <= set("ABCD") and len(earlier.notes) == 2
    # each attempt of a part lies within it
    assert max(a.end for a in earlier.attempts) <= min(a.start for a in found.attempts)
    other = tmp_path / "other.jsonl"
    assert again.name == "again"
    with pytest.raises(LogError, match="its net differs"):
        gather([path, _log_of_a_ring(other)])


def _log_of_a_ring(path: Path) -> str:
    return Story(ring()).start().save(path)
