"""A log that is read while it is written, cut, and taken up again."""

from __future__ import annotations

from agreement.plans import make_plan
from benchmarks.harness.log_tail import LogTail
from benchmarks.harness.team import latencies
from gspn_framework_package.execution.event_log import header
from gspn_framework_package.execution.log_writer import EventLogWriter

PLAN = make_plan(2, 2, False, 0.0, 0.0, False)


def goal(visit: int, attempt: int = 1) -> dict:
    return {"kind": "goal", "place": "p1", "incarnation": 0, "visit": visit, "attempt": attempt}


def test_a_tail_reads_whole_records_only_and_goes_on_after_a_cut(tmp_path) -> None:
    path = tmp_path / "r1.jsonl"
    tail = LogTail(str(path))
    assert tail.read().records == []
    log = EventLogWriter(str(path), header(PLAN, "run", "r1", "log1"))
    log.append(goal(1))
    with open(path, "ab") as file:
        file.write(b'{"kind":"goal","pla')
    assert tail.read().moves() == 1
    log = EventLogWriter(str(path), header(PLAN, "run", "r1", "log1"))
    log.append(goal(1, 2), goal(2))
    assert tail.read().moves() == 2
    assert [r["visit"] for r in tail.of("goal")] == [1, 1, 2]
    assert tail.moves(begin=tail.records[-1]["mono"] + 1.0) == 0


def test_latencies_tell_private_from_coordinated_moves_and_leave_out_what_was_before() -> None:
    def done(kind: str, visit: int, mono: float) -> dict:
        return {"kind": kind, "entry": {"entry": "done", "visit": visit}, "mono": mono}

    records = [
        done("invoked", 1, 1.0),
        dict(goal(2), mono=1.5),
        done("invoked", 2, 10.0),
        dict(goal(3), mono=10.25),
        done("private", 3, 11.0),
        dict(goal(4), mono=11.125),
        done("invoked", 4, 12.0),
        dict(goal(4, 2), mono=12.5),
        dict(goal(5), mono=13.0),
    ]
    assert latencies(records, 5.0) == ([125.0], [250.0, 1000.0])
