"""Large policies are stored once beside the logs, and found by all who read them."""

from __future__ import annotations

import json
import os
import shutil
import threading
from collections import deque
from dataclasses import replace
from pathlib import Path

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import LogFile, header, log_files, read_log
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.logged_attempts import gather
from gspn_framework_package.execution.plan_change import stage_of
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan, read_policy
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy, PolicyRow
from gspn_framework_package.visualizer.replay import Replay

PATROL = Path(__file__).parents[3] / "plans" / "patrol"


def patrol(more: int) -> Plan:
    """The plan of the patrol with so many more rows, which match nothing that it reaches."""
    plan = read_plan(str(PATROL))
    rows = list(plan.policy.rows)
    counts = [0] * (len(plan.policy.places) - 1)
    rows += [PolicyRow((*counts, 100 + k), rows[0].choices) for k in range(more)]
    return replace(plan, policy=Policy(plan.policy.places, rows)).validate()


LARGE = patrol(1_500)


def write_log(path: Path, plan: Plan, robot: str = "") -> None:
    EventLogWriter(str(path), header(plan, "run", robot, robot)).close()


def stored(folder: Path) -> Path:
    (found,) = (folder / "policies").iterdir()
    return found


def test_every_reader_finds_the_policy(tmp_path) -> None:
    run = VirtualRun(LARGE)
    path = tmp_path / "run.jsonl"
    writer = run.record_in(str(path), "run", "log")
    run.run(60.0)
    writer.close()
    with open(path, "rb") as file:
        assert len(file.readline()) < 20_000
    assert read_policy(str(stored(tmp_path))) == LARGE.policy
    log = read_log(str(path))
    assert log.plan.policy == LARGE.policy and log.plan.hash() == LARGE.hash()
    assert LogFile(str(path)).plan.hash() == LARGE.hash()
    assert deque(replay(log), 1)[0].state.ended == "the end of the simulated time"
    assert verify([log]).violation is None
    assert gather(log_files([str(tmp_path)])).attempts
    assert Replay(str(path)).document("run").plan == log.plan
    assert main(["verify", str(tmp_path)]) == 0


def test_robots_share_one_file_which_is_whole_at_any_moment(tmp_path) -> None:
    threads = [
        threading.Thread(target=write_log, args=(tmp_path / ("r%d.jsonl" % k), LARGE, "r%d" % k))
        for k in range(6)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert os.listdir(tmp_path / "policies") == [stored(tmp_path).name]
    for path in log_files([str(tmp_path)]):
        assert read_log(path).plan.policy == LARGE.policy


def test_a_small_policy_stays_in_the_header(tmp_path) -> None:
    path = tmp_path / "run.jsonl"
    write_log(path, patrol(10))
    log = read_log(str(path))
    assert os.listdir(tmp_path) == ["run.jsonl"]
    assert log.header["version"] == 2 and len(log.header["plan"]["policy"]["rows"]) == 15
    assert log.plan.hash() == patrol(10).hash()


def test_a_large_policy_in_the_header_of_an_older_log_is_read(tmp_path) -> None:
    path = tmp_path / "old.jsonl"
    first = header(LARGE, "run", "", "log")
    path.write_text(json.dumps({**first, "version": 1}) + "\n")
    assert read_log(str(path)).plan.policy == LARGE.policy


def test_a_policy_that_is_missing_or_altered_is_reported_with_file_and_hash(
    tmp_path, capsys
) -> None:
    path = tmp_path / "run.jsonl"
    write_log(path, LARGE)
    name = read_log(str(path)).header["plan"]["policy"]["hash"]
    file = stored(tmp_path)
    assert file.name == name + ".json"
    for alter, word in (
        (lambda: file.write_text(file.read_text().replace("0.", "1.", 1)[:-1] + " }"), "altered"),
        (lambda: file.write_bytes(b"\xff{"), "altered"),
        (file.unlink, "missing"),
    ):
        alter()
        with pytest.raises(LogError, match=word) as error:
            assert read_log(str(path)).plan
        assert str(file) in str(error.value) and name in str(error.value)
    assert main(["verify", str(path)]) == 2
    told = capsys.readouterr().err
    assert str(file) in told and "Traceback" not in told
    write_log(path, LARGE)  # a robot that goes on with its log writes the policy again
    assert read_log(str(path)).plan.policy == LARGE.policy


def test_the_large_policy_of_a_staged_plan_is_stored_too(tmp_path) -> None:
    entry = log_entries.to_json(stage_of(LARGE, {"a": "b"}, "/plans"))
    held = {"number": 1, "digest": entry["digest"], "plan": entry["plan"]}
    records = [
        {"kind": "invoked", "entry": entry, "origin": ["r", 0, 1, "l"]},
        {"kind": "accepted", "slot": 1, "batch": [[entry, ["r", 0, 1, "l"], 0]]},
        {"kind": "slot", "slot": 1, "entries": [{"entry": "resume"}, entry]},
        {"kind": "snapshot", "slot": 2, "state": {"adopted": held, "staged": None, "paused": True}},
        {"kind": "snapshot", "slot": 3, "state": {"staged": held}},
    ]
    path = tmp_path / "run.jsonl"
    log = EventLogWriter(str(path), header(patrol(10), "run", "r", "l"))
    log.append(*records)
    log.append(
        {"kind": "slot", "slot": 4, "entries": [log_entries.to_json(stage_of(patrol(9), {}))]}
    )
    log.close()
    lines = path.read_bytes().splitlines()
    assert max(map(len, lines)) < 20_000
    assert read_policy(str(stored(tmp_path))) == LARGE.policy
    found = read_log(str(path)).records
    assert [{key: r[key] for key in given} for r, given in zip(found, records)] == records
    assert found[5]["entries"][0]["plan"]["policy"]["rows"]
    with LogFile(str(path)).open() as file:
        whole = LogFile(str(path))
        assert next(whole.records(file, whole.begin, 2))[0]["entry"] == entry
    stored(tmp_path).unlink()
    with pytest.raises(LogError, match="missing.*run.jsonl"):
        read_log(str(path))


@pytest.mark.parametrize(
    "record",
    [
        {"kind": "slot", "entries": [{"entry": "stage", "plan": 3}, None, 1]},
        {"kind": "accepted", "batch": [[], None, [None], {}]},
        {"kind": "snapshot", "state": {"staged": [], "adopted": {"plan": {"policy": 0}}}},
        {"kind": "invoked", "entry": []},
    ],
)
def test_what_is_no_plan_stays_as_it_is(tmp_path, record) -> None:
    path = tmp_path / "run.jsonl"
    log = EventLogWriter(str(path), header(patrol(10), "run", "r", "l"))
    log.append({**record, "note": {"policy": {"hash": "0"}}})
    (found,) = read_log(str(path)).records
    assert record.items() <= found.items()


def test_a_folder_of_logs_can_be_moved(tmp_path) -> None:
    write_log(tmp_path / "here" / "run.jsonl", LARGE)
    shutil.move(str(tmp_path / "here"), str(tmp_path / "there"))
    assert read_log(str(tmp_path / "there" / "run.jsonl")).plan.policy == LARGE.policy


def test_a_header_that_names_no_proper_hash_is_refused(tmp_path) -> None:
    path = tmp_path / "run.jsonl"
    write_log(path, LARGE)
    first = read_log(str(path)).header
    for name in ("../../etc/passwd", 7, "A" * 32, ""):
        first["plan"]["policy"] = {"hash": name}
        path.write_text(json.dumps({**first, "version": 1}) + "\n")
        with pytest.raises(LogError, match="contains no plan"):
            assert read_log(str(path)).plan


def test_where_the_policy_cannot_be_written_there_is_one_error(tmp_path) -> None:
    (tmp_path / "policies").write_text("in the way")
    with pytest.raises(LogError, match="cannot be written"):
        write_log(tmp_path / "run.jsonl", LARGE)
    assert not (tmp_path / "run.jsonl").exists()
