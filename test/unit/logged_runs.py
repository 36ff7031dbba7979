"""Event logs for tests: written entry by entry, or by simulated teams."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List

from game_driver import make_plan

from agreement.world import World
from gspn_framework_package.execution.event_log import header
from gspn_framework_package.execution.firing import Ended
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.log_writer import record_line
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.plan import Plan


def ring(**fields: Any) -> Plan:
    """A and B in a ring; B is left by t2, or by t3 that needs a token of the resource R, which the
    environment makes."""
    net = (
        NetBuilder("ring")
        .place("A", tokens=2)
        .place("B")
        .place("R")
        .exponential("t1", inputs="A", outputs="B", rate=2.0)
        .exponential("t2", inputs="B", outputs="A")
        .exponential("t3", inputs=["B", "R"], outputs="A")
        .exponential("made", outputs="R", rate=4.0, inhibitors={"R": 2})
        .build()
    )
    return make_plan(net, ["A", "A"], resources=["R"], **fields)


class Story:
    """A log that is written entry by entry, at the times told."""

    def __init__(self, plan: Plan, robot: str = "", log: str = "log1", run: str = "run") -> None:
        self.plan = plan
        self.ledger = Ledger(TokenGame(plan, agents=not robot))
        head = header(plan, run, robot, log, agents=not robot, host="boot")
        text, self.sum = record_line({**head, "wall": 1e9, "mono": 100.0}, "")
        self.lines = [text]
        self.records: List[Dict[str, Any]] = []

    def write(self, t: float, **record: Any) -> None:
        record = {**record, "wall": 1e9 + t, "mono": 100.0 + t}
        text, self.sum = record_line(record, self.sum)
        self.lines.append(text)
        self.records.append(record)

    def slot(self, t: float, *entries: Any) -> None:
        slot = self.ledger.length
        step = self.ledger.game.reduce(self.ledger.state, slot, list(entries))
        self.write(t, **self.ledger.record(slot, list(entries), [], step))
        for command in step.commands:
            if isinstance(command, Ended):
                self.write(t, kind="ended", reason=command.reason, finished=command.finished)

    def start(self, t: float = 0.0) -> Story:
        self.slot(t, self.ledger.game.start_entry())
        return self

    def save(self, path: Any) -> str:
        path.write_text("".join(self.lines))
        return str(path)


def save_logs(world: World, folder: Path) -> List[str]:
    """Save the logs of the robots of a simulated team; their paths."""
    paths = []
    for number, disk in enumerate(world.logs()):
        chain, lines = "", []
        for record in [disk.header, *disk.records()]:
            line, chain = record_line(record, chain)
            lines.append(line)
        path = folder / ("log_%d.jsonl" % number)
        path.write_text("".join(lines))
        paths.append(str(path))
    return paths
