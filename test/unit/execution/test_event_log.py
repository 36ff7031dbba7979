"""The event log: written, read, cut, damaged, taken up again, replayed."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace

import pytest

from agreement.plans import make_plan
from gspn_framework_package.execution import log_damage, log_entries
from gspn_framework_package.execution.event_log import header, read_log
from gspn_framework_package.execution.ledger import Item, Ledger, Origin
from gspn_framework_package.execution.log_damage import end_is_there
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.errors import LogError

PLAN = make_plan(2, 2, False, 0.0, 0.0, False)


def written(path, *, done: int = 3):
    """A log of a run in which r1 goes through some places."""
    writer = EventLogWriter(str(path), header(PLAN, "run", "r1", "log1"))
    ledger = Ledger(TokenGame(PLAN))

    def append(entry):
        slot = ledger.length
        step = ledger.game.reduce(ledger.state, slot, [entry])
        writer.append(ledger.record(slot, [entry], [], step))

    append(ledger.game.start_entry())
    for result in ["t1", "t2", "t3", "t4"][:done]:
        robot = ledger.state.robots["r1"]
        append(log_entries.Done("r1", 0, robot.visit, result))
    writer.close()
    return ledger


def test_what_is_written_is_read_and_replayed(tmp_path) -> None:
    path = tmp_path / "deep" / "r1.jsonl"
    ledger = written(path)
    read = read_log(str(path))
    assert (read.robot, read.cut, len(read.records)) == ("r1", False, 4)
    assert read.plan.hash() == PLAN.hash()
    assert all(r["mono"] > 0 and r["wall"] > 1e9 for r in read.records)
    steps = list(replay(read))
    assert [f.transition for s in steps for f in s.firings] == ["t1", "t2", "t3"]
    assert steps[-1].state == ledger.state


def test_a_log_of_a_plan_with_weights_of_exponential_transitions_is_read(tmp_path) -> None:
    net = PLAN.net
    timed = next(t for t in net.transitions if t.timed)
    plan = replace(PLAN, net=net.with_transition(timed._replace(weight=0.5)))
    EventLogWriter(str(tmp_path / "r1.jsonl"), header(plan, "run", "r1", "log1")).close()
    assert read_log(str(tmp_path / "r1.jsonl")).plan.hash() == plan.hash() == PLAN.hash()


def test_a_cut_last_line_is_dropped_and_removed_when_the_log_is_taken_up(tmp_path) -> None:
    path = tmp_path / "r1.jsonl"
    written(path)
    whole = path.read_bytes()
    for cut in (1, 20, 200):
        path.write_bytes(whole[:-cut])
        read = read_log(str(path))
        assert read.cut
        assert len(read.records) == 3
    writer = EventLogWriter(str(path), header(PLAN, "run", "r1", "log2"))
    writer.append({"kind": "life", "incarnation": 1})
    writer.close()
    read = read_log(str(path))
    assert not read.cut
    assert [r["kind"] for r in read.records] == ["slot", "slot", "slot", "life"]
    assert read.header["log"] == "log1"


def test_a_header_that_was_cut_makes_a_new_log(tmp_path) -> None:
    path = tmp_path / "r1.jsonl"
    path.write_text('{"kind": "head')
    EventLogWriter(str(path), header(PLAN, "run", "r1", "log2")).close()
    assert read_log(str(path)).header["log"] == "log2"


def test_a_log_of_another_run_is_not_taken_up(tmp_path) -> None:
    path = tmp_path / "r1.jsonl"
    written(path)
    with pytest.raises(LogError, match="run 'run', not 'other'"):
        EventLogWriter(str(path), header(PLAN, "other", "r1", "log2"))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda lines: [], "is empty"),
        (lambda lines: ["not json\n", *lines[1:]], "line|:1: is not an event log"),
        (lambda lines: ['{"format": "other"}\n'], "is not an event log"),
        (lambda lines: [lines[0].replace('"version":2', '"version":9')], "version 9"),
        (lambda lines: [*lines[:2], "garbage\n", *lines[2:]], ":3: is not JSON"),
        (lambda lines: [*lines[:2], "[1]\n", *lines[2:]], ":3: is not a record"),
    ],
)
def test_damage_is_reported_with_the_line(tmp_path, damage, message) -> None:
    path = tmp_path / "r1.jsonl"
    written(path)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(damage(lines)))
    with pytest.raises(LogError, match=message):
        read_log(str(path))


def unsummed(path) -> None:
    """Make it a log of version 1, whose lines have no running hash."""
    text = re.sub(r',"sum":"[0-9a-f]{16}"}', "}", path.read_text())
    path.write_text(text.replace('"version":2', '"version":1', 1))


def test_a_log_of_the_version_before_is_read_and_gone_on_with(tmp_path) -> None:
    path = tmp_path / "r1.jsonl"
    written(path)
    unsummed(path)
    assert "sum" not in path.read_text()
    writer = EventLogWriter(str(path), header(PLAN, "run", "r1", "log2"))
    writer.append({"kind": "life", "incarnation": 1})
    writer.close()
    read = read_log(str(path))
    assert [r["kind"] for r in read.records] == ["slot", "slot", "slot", "slot", "life"]
    assert len(list(replay(read))) == 4


def test_a_line_that_was_changed_or_dropped_is_reported(tmp_path) -> None:
    path = tmp_path / "r1.jsonl"
    written(path)
    writer = EventLogWriter(str(path), header(PLAN, "run", "r1", "log2"))
    writer.append({"kind": "life", "incarnation": 1})
    writer.close()
    assert len(read_log(str(path)).records) == 5
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:2] + lines[3:]))
    with pytest.raises(LogError, match=":3: does not follow from the lines before it"):
        read_log(str(path))


def test_the_end_of_a_log_is_not_trusted_after_the_machine_was_started_anew(
    tmp_path, monkeypatch
) -> None:
    for fsync in (False, True):
        path = tmp_path / ("%s.jsonl" % fsync)
        writer = EventLogWriter(str(path), header(PLAN, "run", "r1", "log1"), fsync=fsync)
        writer.append({"kind": "life", "incarnation": 0})
        writer.close()
        assert end_is_there(read_log(str(path)))
        monkeypatch.setattr(log_damage, "boot_id", lambda: "another boot")
        assert end_is_there(read_log(str(path))) == fsync
        monkeypatch.undo()


def test_durable_records_are_waited_for_once_and_others_not(tmp_path, monkeypatch) -> None:
    writer = EventLogWriter(
        str(tmp_path / "r1.jsonl"), header(PLAN, "run", "r1", "log1"), fsync=True
    )
    synced = []
    monkeypatch.setattr(os, "fdatasync", synced.append)
    writer.append({"kind": "goal"}, {"kind": "cancel"}, durable=False)
    assert not synced
    writer.append({"kind": "promised"}, {"kind": "accepted"})
    assert len(synced) == 1


def test_a_log_that_does_not_follow_is_not_replayed(tmp_path) -> None:
    path = tmp_path / "r1.jsonl"
    written(path)
    unsummed(path)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:2] + lines[3:]))
    with pytest.raises(LogError, match="slot 2 follows instead of slot 1"):
        list(replay(read_log(str(path))))
    changed = json.loads(lines[2])
    changed["firings"] = []
    path.write_text("".join([*lines[:2], json.dumps(changed) + "\n"]))
    with pytest.raises(LogError, match="other firings"):
        list(replay(read_log(str(path))))


def test_missing_file_and_folder(tmp_path) -> None:
    with pytest.raises(LogError, match="cannot be read"):
        read_log(str(tmp_path / "none.jsonl"))
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match="cannot be written"):
        EventLogWriter(
            os.path.join(str(tmp_path / "file"), "x.jsonl"), header(PLAN, "r", "r1", "x")
        )


def test_repeats_have_no_effect_in_a_ledger() -> None:
    ledger = Ledger(TokenGame(PLAN))
    ledger.append([Item(ledger.game.start_entry(), Origin("", 0, 0))])
    first = Item(log_entries.Done("r1", 0, 1, "t1"), Origin("r1", 0, 1, "a"))
    late = Item(log_entries.Pause(), Origin("r1", 0, 1, "b"))
    record, step = ledger.append([first, first, late])
    assert len(record["entries"]) == len(step.firings) == 1
    again = Ledger(TokenGame(PLAN))
    again.restore(json.loads(json.dumps(ledger.snapshot())))
    assert (again.state, again.hash, again.seen) == (ledger.state, ledger.hash, ledger.seen)
