"""``gspn explain``: firing sequences step by step."""

import json
from pathlib import Path

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import read_net

PLANS = Path(__file__).parents[2] / "plans"


def explained(capsys, *words):
    code = main(["explain", *words, "--json"])
    return code, json.loads(capsys.readouterr().out)["sequences"]


def test_the_sequences_of_the_check_are_played_to_the_marking_that_it_names(capsys):
    code, (found,) = explained(capsys, str(PLANS / "rendezvous"))
    assert code == 0 and found["check"] == "dead_after_loss" and not found["stopped_by"]
    main(["check", str(PLANS / "rendezvous"), "--json"])
    item = next(
        item for item in json.loads(capsys.readouterr().out)["items"] if item.get("sequence")
    )
    assert [step["transition"] for step in found["steps"]] == item["sequence"]
    assert found["steps"][-1]["marking"] == item["marking"]
    assert found["enabled_at_the_end"] == []


def test_a_given_sequence_is_played_until_one_cannot_fire(capsys):
    code, (found,) = explained(capsys, str(PLANS / "tokens"), "t1", "t1", "t2")
    assert code == 1 and found["start"] == {"p1": 1}
    assert found["steps"] == [{"transition": "t1", "marking": {"p2": 1}}]
    assert found["stopped_by"] == "t1 cannot fire: p1 has 0 of 1 token"
    assert found["enabled_at_the_end"] == ["t2"]
    code, (found,) = explained(capsys, str(PLANS / "tokens"), "nothing")
    assert code == 1 and "nothing" in found["stopped_by"]


def test_the_text_has_a_line_for_each_firing(capsys):
    assert main(["explain", str(PLANS / "tokens"), "t1", "t2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "at the start: p1 1" and lines[1].split() == ["1", "t1:", "p2", "1"]
    assert lines[-1].startswith("then enabled: ")
    assert main(["explain", str(PLANS / "tokens")]) == 0
    assert "no finding of the check has a firing sequence" in capsys.readouterr().out


def test_what_the_places_and_transitions_of_a_run_net_stand_for(capsys):
    assert main(["explain", str(PLANS / "rendezvous"), "--run-net", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["places"]["Docked_done_wants_Hand_Over"] == {
        "of": "Docked",
        "text": "robots: Docked (done, wants Hand_Over)",
    }
    fires = {name: t["of"] for name, t in told["transitions"].items() if t["fires"]}
    plan = json.loads((PLANS / "rendezvous" / "plan.json").read_text())
    net = read_net(PLANS / "rendezvous" / plan["net"])
    assert set(fires.values()) == {t.name for t in net.transitions}
    assert main(["explain", str(PLANS / "rendezvous"), "--run-net"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "%d places:" % len(told["places"])
    assert "%d transitions:" % len(told["transitions"]) in lines
    assert len(lines) == 2 + len(told["places"]) + len(told["transitions"])


def test_a_run_net_plays_no_transitions(capsys):
    assert main(["explain", str(PLANS / "tokens"), "t1", "--run-net"]) == 2
    assert "--run-net fires no transitions" in capsys.readouterr().err
