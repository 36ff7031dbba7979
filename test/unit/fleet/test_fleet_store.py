"""Logs that are read into a store of a fleet's history, and the reports on it."""

from __future__ import annotations

import builtins
import csv
import io
import json
import os
import sys
from pathlib import Path
from typing import Any, Dict, List

import pytest
from logged_runs import Story, ring, save_logs

from agreement.plans import make_plan as team_plan
from agreement.world import World
from gspn_framework_package.cli import history
from gspn_framework_package.cli.main import main
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.log_entries import Done, Failed
from gspn_framework_package.fleet import store as stores
from gspn_framework_package.fleet.database import OLDEST_FOR_SQL, duckdb
from gspn_framework_package.fleet.ingest import Ingest, IngestedLog
from gspn_framework_package.fleet.reports import Question, ask_sql, history_report, moments
from gspn_framework_package.fleet.store import Store
from gspn_framework_package.model.errors import InputError, UsageError

VERSION = tuple(int(part) for part in duckdb().__version__.split(".")[:2])
KEPT = pytest.mark.skipif(
    VERSION < OLDEST_FOR_SQL, reason="this DuckDB cannot be restricted to the files of a store"
)


def patrol_story() -> Story:
    story = Story(ring()).start()
    story.slot(1.5, Done("a", 0, 1, "t1"))
    story.slot(4.0, Done("a", 0, 2, "t3"))
    story.slot(5.0, Failed("b", 0, 1, 1, "aborted"))
    story.slot(8.0, log_entries.Retry("b"))
    story.slot(9.0, log_entries.Fire("made"))
    return story


def ingest(store: Store, *paths: Any) -> List[IngestedLog]:
    with store.locked():
        return list(Ingest(store).read([str(path) for path in paths]))


def totals(store: Store, *by: str) -> List[Dict[str, Any]]:
    return history_report(store, Question(by or ("robot", "place")))


def table_files(store: Store) -> List[Path]:
    return sorted(Path(store.folder).rglob("*.parquet"))


@pytest.fixture(name="store")
def _store(tmp_path: Path) -> Store:
    return Store(str(tmp_path / "store"), create=True)


def test_a_log_is_read_once_and_reported(tmp_path: Path, store: Store) -> None:
    path = patrol_story().save(tmp_path / "log.jsonl")
    (log,) = ingest(store, path)
    assert (log.slots, log.error) == (6, "")
    rows = totals(store)
    names = ("robot", "place", "visits", "acting_s", "waiting_s", "failed_s")
    assert [tuple(row[n] for n in names) for row in rows] == [
        ("a", "A", 2, 1.5, 0.0, 0.0),
        ("a", "B", 1, 2.5, 5.0, 0.0),
        ("b", "A", 1, 6.0, 0.0, 3.0),
    ]
    assert [(row["failures"], row["alarms"], row["interventions"]) for row in rows] == [
        (0, 0, 0),
        (0, 0, 0),
        (1, 1, 1),
    ]
    assert rows[1]["use"] == pytest.approx(2.5 / 7.5)
    before = table_files(store)
    assert [(log.slots, log.rows) for log in ingest(store, path, path)] == [(0, 0)]
    assert (table_files(store), totals(store)) == (before, rows)


def test_a_log_that_grows_is_read_on(tmp_path: Path, store: Store) -> None:
    story = patrol_story()
    whole = Store(str(tmp_path / "whole"), create=True)
    ingest(whole, story.save(tmp_path / "whole.jsonl"))
    text = (tmp_path / "whole.jsonl").read_bytes()
    path = tmp_path / "log.jsonl"
    for size in [*range(text.index(b"\n") + 1, len(text), 120), len(text)]:
        path.write_bytes(text[:size])  # the last line is mostly cut
        assert [log.error for log in ingest(store, path)] == [""]
    assert totals(store) == totals(whole)
    assert totals(store, "day") == totals(whole, "day")
    assert len(table_files(store)) <= 3 * (stores.MOST_FILES + 1)  # small ones are merged


def test_the_logs_of_a_team_are_one_run(tmp_path: Path, store: Store) -> None:
    world = World(team_plan(0, 3, False, 0.0, 0.0, False), 5)
    for node in world.nodes.values():
        node.start()
    world.run(2.0)
    world.acting = False
    assert world.run(8.0, world.has_settled)
    paths = save_logs(world, tmp_path)
    found = ingest(store, *paths)
    assert [log.error or log.left_out for log in found] == [""] * 3
    assert [log.slots > 0 for log in found] == [True, False, False]
    (run,) = store.runs()
    assert len(run["logs"]) == 3
    visits = {row["robot"]: row["visits"] for row in totals(store, "robot")}
    robots = next(iter(world.nodes.values())).replica.state.ledger.state.robots
    assert visits == {name: robot.visit for name, robot in robots.items()}


def test_another_log_of_a_team_goes_on_where_the_first_one_ends(
    tmp_path: Path, store: Store
) -> None:
    def story(robot: str, log: str) -> Story:
        return Story(ring(), robot, log).start()

    one, two = story("a", "log1"), story("b", "log2")
    for each in (one, two):
        each.slot(1.5, Done("a", 0, 1, "t1"))
    two.slot(6.0, Done("a", 0, 2, "t2"))
    ingest(store, one.save(tmp_path / "one.jsonl"))
    (log,) = ingest(store, two.save(tmp_path / "two.jsonl"))
    assert log.slots == 1
    (row,) = [row for row in totals(store) if (row["robot"], row["place"]) == ("a", "B")]
    assert (row["visits"], row["acting_s"]) == (1, 4.5)


def test_a_log_that_contradicts_another_of_its_run_is_named(tmp_path: Path, store: Store) -> None:
    one, two = (Story(ring(), robot, log).start() for robot, log in (("a", "1"), ("b", "2")))
    one.slot(1.5, Done("a", 0, 1, "t1"))
    two.slot(1.5, Done("b", 0, 1, "t1"))
    ingest(store, one.save(tmp_path / "one.jsonl"))
    before = totals(store)
    (log,) = ingest(store, two.save(tmp_path / "two.jsonl"))
    assert "two.jsonl:3: slot 1 differs" in log.error
    assert totals(store) == before


def test_a_damaged_log_is_named_and_nothing_of_it_is_kept(tmp_path: Path, store: Store) -> None:
    good = patrol_story()
    bad = Story(ring(), log="log2").start()
    for number in range(4):
        bad.slot(number + 1.0, log_entries.Pause("a"), log_entries.Resume("a"))
    lines = "".join(bad.lines).replace('"wall":1000000003', '"wall":1000000033', 1)
    (tmp_path / "bad.jsonl").write_text(lines)
    (tmp_path / "none.jsonl").write_text("no log\n")
    good.save(tmp_path / "good.jsonl")
    found = {Path(log.log).name: log for log in ingest(store, tmp_path)}
    assert "bad.jsonl:5: does not follow from the lines before it" in found["bad.jsonl"].error
    assert found["none.jsonl"].error
    assert found["good.jsonl"].slots == 6
    assert len(store.runs()) == 1
    assert len(table_files(store)) == 3


def test_lines_that_were_read_before_must_still_be_there(tmp_path: Path, store: Store) -> None:
    path = tmp_path / "log.jsonl"
    ingest(store, patrol_story().save(path))
    before = totals(store)
    other = Story(ring()).start()
    for _ in range(20):
        other.slot(2.0, log_entries.Pause("a"), log_entries.Resume("a"))
    (log,) = ingest(store, other.save(path))
    assert "has changed since it was read up to line 7" in log.error
    assert totals(store) == before


def test_an_ingest_that_is_interrupted_leaves_nothing_behind(
    tmp_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    path = patrol_story().save(tmp_path / "log.jsonl")
    with monkeypatch.context() as patch:
        patch.setattr(Store, "commit", interrupted)
        with pytest.raises(KeyboardInterrupt):
            ingest(store, path)
    assert table_files(store)
    assert store.runs() == []
    assert totals(store) == []
    assert ingest(store, path)[0].slots == 6
    assert len(table_files(store)) == 3


def test_two_ingests_do_not_write_at_the_same_time(store: Store) -> None:
    with store.locked(), pytest.raises(InputError, match="another ingest"), store.locked():
        pass


def test_a_report_can_be_narrowed_and_grouped(tmp_path: Path, store: Store) -> None:
    ingest(store, patrol_story().save(tmp_path / "log.jsonl"))
    (row,) = history_report(store, Question(("day",), robots=("b",)))
    assert (row["day"], row["visits"]) == ("2001-09-09", 1)
    assert history_report(store, Question(("place",), until="2001-09-08")) == []
    for wrong in (
        Question(("hour",)),
        Question(("day", "day")),
        Question(since="yesterday"),
        Question(since="2001-09-09", until="2001-09-08"),
        Question(robots=("nobody",)),
        Question(places=("nowhere",)),
    ):
        with pytest.raises(UsageError):
            history_report(store, wrong)


def test_moments_are_what_a_person_may_want_to_look_at(tmp_path: Path, store: Store) -> None:
    ingest(store, patrol_story().save(tmp_path / "log.jsonl"))
    found = moments(store, Question())
    assert [(m["kind"], m["robot"], m["place"], m["slot"]) for m in found] == [
        ("intervention", "b", "A", 4),
        ("failure", "b", "A", 3),
        ("alarm", "b", "A", 3),
        ("wait", "a", "B", 1),
    ]
    assert found[-1]["detail"] == "5.0 s"
    assert {m["run"] for m in found} == {store.runs()[0]["key"]}


@KEPT
def test_a_question_in_sql_reads_the_store_and_nothing_else(tmp_path: Path, store: Store) -> None:
    secret = tmp_path / "secret.csv"
    secret.write_text("a\n1\n")
    ingest(store, patrol_story().save(tmp_path / "log.jsonl"))
    answer = ask_sql(store, "SELECT robot, count(*) AS n FROM stays GROUP BY robot ORDER BY robot")
    assert (answer.columns, list(answer.rows)) == (["robot", "n"], [("a", 3), ("b", 1)])
    files = table_files(store)
    for wrong in (
        "SELECT * FROM '%s'" % secret,
        "SELECT * FROM glob('%s/*')" % tmp_path,
        "COPY (SELECT 1) TO '%s'" % secret,
        "COPY (SELECT 1) TO '%s'" % files[0],
        "SET enable_external_access=true",
        "ATTACH '%s' AS other" % (tmp_path / "other.db"),
        "SELECT 1; SELECT 2",
        "DROP VIEW stays",
        "SELECT nothing FROM stays",
        "",
    ):
        with pytest.raises(UsageError):
            ask_sql(store, wrong)
    assert secret.read_text() == "a\n1\n"
    assert list(ask_sql(store, "SELECT sum(visits) FROM totals").rows) == [(4,)]


@pytest.mark.skipif(VERSION >= OLDEST_FOR_SQL, reason="this DuckDB can be kept to files")
def test_a_duckdb_that_could_read_other_files_is_not_asked(store: Store) -> None:
    with pytest.raises(InputError, match=r"DuckDB 1\.2 or later"):
        ask_sql(store, "SELECT 1")


def test_a_folder_that_is_no_store_is_refused(tmp_path: Path) -> None:
    for folder in (tmp_path / "nothing", tmp_path):
        with pytest.raises(InputError, match="is not a store"):
            Store(str(folder))
    (tmp_path / "letter.txt").write_text("hello")
    with pytest.raises(InputError, match="is not a store"):
        Store(str(tmp_path), create=True)  # a folder with other things stays as it is
    assert [path.name for path in tmp_path.iterdir()] == ["letter.txt"]


@pytest.mark.parametrize(
    "text",
    ["[]", "{", "[" * 100_000, '{"format": "gspn history", "version": 1e999}', "\x00", '{"a": {}}'],
)
@pytest.mark.parametrize("name", ["history.json", "runs/monday.json"])
def test_a_damaged_file_of_a_store_is_named_in_one_line(
    store: Store, name: str, text: str, capsys: Any
) -> None:
    Path(store.folder, name).write_text(text)
    for words in (["report"], ["ingest", store.folder]):
        assert main(["history", *words, "--store", store.folder]) == 2
        told = capsys.readouterr().err.strip()
        assert name in told and "Traceback" not in told and "internal" not in told


def test_a_fifo_in_a_store_is_not_waited_for(store: Store, capsys: Any) -> None:
    os.mkfifo(os.path.join(store.folder, "runs", "monday.json"))
    assert main(["history", "report", "--store", store.folder]) == 2
    assert "monday.json" in capsys.readouterr().err


# -- the command line ------------------------------------------------------------------------------


def test_the_verb_ingests_and_reports(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    log, store = patrol_story().save(tmp_path / "log.jsonl"), str(tmp_path / "store")
    assert main(["history", "ingest", log, "--store", store]) == 0
    assert "6 slots new" in capsys.readouterr().out
    assert main(["history", "report", "--store", store, "--by", "robot,place", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [row["visits"] for row in told["rows"]] == [2, 1, 1]
    assert main(["history", "report", "--store", store, "--by", "place", "--csv"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [(row["place"], row["visits"]) for row in rows] == [("A", "3"), ("B", "1")]
    monkeypatch.setattr(history, "_SHOWN", 1)
    assert main(["history", "report", "--store", store, "--by", "place"]) == 0
    _, shown, more = capsys.readouterr().out.splitlines()
    assert shown.startswith("A") and "--csv and --json print all" in more
    assert main(["history", "report", "--store", store, "--since", "2020-01-01"]) == 0
    assert "no matching data in the store" in capsys.readouterr().out
    (tmp_path / "log.jsonl").write_text("no log\n")
    assert main(["history", "ingest", log, "--store", store, "--json"]) == 1
    assert "log.jsonl" in json.loads(capsys.readouterr().out)["logs"][0]["error"]


def test_a_missing_duckdb_is_named_with_the_line_that_installs_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "duckdb":
            raise ModuleNotFoundError("No module named 'duckdb'", name="duckdb")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    assert main(["history", "ingest", "log", "--store", str(tmp_path / "store")]) == 2
    line = "pip install duckdb" if sys.version_info >= (3, 9) else 'pip install "duckdb<1.2"'
    assert line in capsys.readouterr().err
    assert not (tmp_path / "store").exists()
