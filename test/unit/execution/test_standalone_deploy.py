"""Another plan for a standalone run: adopted while its agents act."""

from __future__ import annotations

import sys
import threading
import time
from dataclasses import replace

import pytest

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import header, read_log
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats.plan_json import plan_from_json
from gspn_framework_package.model.errors import ExecutionError, PlanError, RefusedError
from gspn_framework_package.model.policy import Policy, PolicyRow

ACTIONS = """
import sys
import threading

GO = threading.Event()

def old(is_cancelled):
    GO.wait(30)
    return "ab"

def new(is_cancelled):
    is_cancelled.wait(0.01)
"""


def _plan(folder, arcs, actions, start="A", timed=True):
    places = sorted({p for pair in arcs.values() for p in pair})
    net = {
        "places": [{"name": p, "tokens": int(p == start)} for p in places],
        "transitions": [{"name": t, "timed": timed} for t in arcs],
        "arcs": [
            arc
            for t, (a, b) in arcs.items()
            for arc in ({"from": a, "to": t}, {"from": t, "to": b})
        ],
    }
    return plan_from_json({"net": net, "actions": actions}, folder=str(folder))


class _Heard(Listener):
    def __init__(self):
        self.fired, self.plans = [], []
        self.there = threading.Condition()

    def on_step(self, slot, entries, firings, state):
        with self.there:
            self.fired += [f.transition for f in firings]
            self.there.notify_all()

    def on_plan(self, plan):
        self.plans.append(plan.name)

    def wait_for(self, transition):
        with self.there:
            assert self.there.wait_for(lambda: transition in self.fired, 30), self.fired


def test_a_run_goes_on_under_another_plan(tmp_path) -> None:
    name = "acts_%d" % time.monotonic_ns()
    (tmp_path / (name + ".py")).write_text(ACTIONS)
    old, new = "%s.old" % name, "%s.new" % name
    plan = _plan(tmp_path, {"ab": "AB", "ba": "BA"}, {"A": old, "B": new})
    log = EventLogWriter(str(tmp_path / "log.jsonl"), header(plan, "r", "", "x", agents=True))
    heard = _Heard()
    executor = StandaloneExecutor(plan, heard, log)
    executor.start()
    wider = {"xb": "XB", "bc": "BC", "cx": "CX"}
    bound = dict.fromkeys("XBC", new)
    with pytest.raises(RefusedError, match="is in 'A'"):
        executor.deploy(_plan(tmp_path, wider, bound, "X"))
    with pytest.raises(PlanError):
        executor.deploy(_plan(tmp_path, wider, {**bound, "C": name + ".none"}, "X"), {"A": "X"})
    mapping = {"A": "X", "ab": "xb", "ba": "bc"}
    executor.deploy(_plan(tmp_path, wider, bound, "X"), mapping)
    assert heard.plans and executor.status()["marking"] == {"X": 1, "B": 0, "C": 0}

    _module(name).GO.set()
    heard.wait_for("cx")
    assert heard.fired[:3] == ["xb", "bc", "cx"]
    executor.stop()
    executor.wait(10)
    log.close()
    read = read_log(str(tmp_path / "log.jsonl"))
    assert verify([read]).violation is None
    assert list(replay(read))[-1].state.ended


EDITED = """
import threading

GO = threading.Event()

def act(is_cancelled):
    while not GO.is_set() and not is_cancelled.wait(0.01):
        pass
    return %r
"""


def test_actions_that_start_after_an_edited_module_was_deployed_use_it(tmp_path) -> None:
    name = "edited_%d" % time.monotonic_ns()
    module = tmp_path / (name + ".py")
    module.write_text(EDITED % "ab")
    plan = _plan(tmp_path, {"ab": "AB", "ac": "AC", "ba": "BA"}, dict.fromkeys("AB", name + ".act"))
    before = _module(name)
    heard = _Heard()
    executor = StandaloneExecutor(plan, heard)
    executor.start()
    first = _module(name)
    assert before is None and first is not None
    module.write_text(EDITED % "ba" + "GO.set()\n")
    executor.deploy(plan)
    second = _module(name)
    assert second is not first and not heard.fired  # the action under way goes on as it was
    first.GO.set()
    heard.wait_for("ba")
    assert heard.fired[:2] == ["ab", "ba"]
    executor.stop()
    executor.wait(10)


def _module(name):
    return next((m for n, m in sys.modules.items() if n.endswith(name)), None)


@pytest.mark.long
def test_a_large_policy_is_not_in_the_log_of_a_run_that_adopts_it(tmp_path) -> None:
    name = "acts_%d" % time.monotonic_ns()
    (tmp_path / (name + ".py")).write_text(ACTIONS)
    arcs = {"ab": "AB", "ac": "AC", "ba": "BA", "ca": "CA"}
    plan = _plan(tmp_path, arcs, dict.fromkeys("ABC", name + ".new"), timed=False)
    never = [PolicyRow((7, 100 + n), (("ab", 1.0),)) for n in range(2_000)]
    rows = [*never, PolicyRow((1, None), (("ac", 1.0),))]
    log = EventLogWriter(str(tmp_path / "log.jsonl"), header(plan, "r", "", "x", agents=True))
    heard = _Heard()
    executor = StandaloneExecutor(plan, heard, log)
    executor.start()
    executor.deploy(replace(plan, policy=Policy(("A", "B"), rows)).validate())
    heard.wait_for("ca")
    executor.stop()
    executor.wait(10)
    log.close()
    assert (tmp_path / "log.jsonl").stat().st_size < 100_000
    read = read_log(str(tmp_path / "log.jsonl"))
    assert verify([read]).violation is None
    adopted = list(replay(read))[-1].state.adopted
    assert len(adopted.plan["policy"]["rows"]) == 2_001


def test_a_plan_that_was_given_up_is_not_adopted_later(tmp_path) -> None:
    name = "acts_%d" % time.monotonic_ns()
    (tmp_path / (name + ".py")).write_text(ACTIONS)
    plan = _plan(tmp_path, {"ab": "AB", "ba": "BA"}, dict.fromkeys("AB", name + ".old"))
    go_on, paused = threading.Event(), threading.Event()

    class Slow(_Heard):
        def on_step(self, slot, entries, firings, state):
            go_on.wait(60)
            if state.paused:
                paused.set()

    heard = Slow()
    executor = StandaloneExecutor(plan, heard)
    executor.start()
    with pytest.raises(ExecutionError, match="not adopted within 0.1 s"):
        executor.deploy(plan, timeout=0.1)
    go_on.set()
    executor.order(log_entries.Pause())  # taken up after what was asked before
    assert paused.wait(30) and not heard.plans
    executor.deploy(plan)
    assert len(heard.plans) == 1
    executor.stop()
    executor.wait(10)
