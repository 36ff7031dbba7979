"""Actions that are Python functions: finding them, and what they are given."""

import builtins
import os
import threading

import pytest

from gspn_framework_package.execution.actions import (
    ActionContext,
    Cancellation,
    PythonAction,
    action,
    load_action,
    load_actions,
    no_feedback,
)
from gspn_framework_package.execution.plan_modules import allow_modules
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import PlanError
from gspn_framework_package.model.plan import Plan, RobotSpec


def context(**changes):
    fields = {
        "place": "P1",
        "robot": "robot_1",
        "feedback": no_feedback,
        "is_cancelled": Cancellation(),
    }
    return ActionContext(**{**fields, **changes})


def write(folder, name, text):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return str(folder)


def rewrite(path, text):
    """Change a file in the same second, a moment later."""
    before = path.stat().st_mtime_ns
    path.write_text(text)
    os.utime(path, ns=(before + 1, before + 1))


def test_a_function_gets_what_it_asks_for_by_name():
    seen = []

    def every(place, robot, feedback, is_cancelled, visit, attempt, other=3):
        seen.append((place, robot, visit, attempt, is_cancelled(), other))
        feedback(1)
        return "T1"

    told = []
    asked = context(feedback=told.append, visit=4, attempt=2)
    ran = PythonAction(every, "a.every")(asked).transition
    assert (ran, seen, told) == ("T1", [("P1", "robot_1", 4, 2, False, 3)], [1])


@pytest.mark.parametrize(
    "robot, number", [("3", 3), ("robot_12", 12), ("arm2_7", 7), ("carol", "carol")]
)
def test_an_action_may_ask_for_the_number_of_its_robot(robot, number):
    seen = []
    PythonAction(lambda id: seen.append(id), "a.one")(context(robot=robot))
    assert seen == [number]


@pytest.mark.parametrize(
    "function, result",
    [
        (lambda: None, ""),
        (lambda: "None", "None"),
        (lambda robot: robot, "robot_1"),
        (lambda id: "number %d" % id, "number 1"),
        (lambda **everything: everything["place"], "P1"),
        (lambda: 42, "42"),
        (lambda: ["T1"], "['T1']"),
    ],
)
def test_results(function, result):
    assert PythonAction(function, "a.f")(context()).transition == result


def test_a_class_is_instantiated_once_for_each_robot():
    class Counter:
        def __init__(self, robot):
            self.robot, self.calls = robot, 0

        def __call__(self, place):
            self.calls += 1
            return "%s %s %d" % (self.robot, place, self.calls)

    count = PythonAction(Counter, "a.Counter")
    assert count(context()).transition == "robot_1 P1 1"
    assert count(context(robot="robot_2", place="P2")).transition == "robot_2 P2 1"
    assert count(context()).transition == "robot_1 P1 2"


def test_a_cancelled_wait_ends_at_once():
    cancellation = Cancellation()
    threading.Timer(0.01, cancellation.cancel).start()
    assert cancellation.wait(60.0)
    assert cancellation()


def test_the_decorator_returns_the_function_and_refuses_unknown_parameters():
    def good(place):
        return place

    assert action(good) is good
    with pytest.raises(PlanError, match="parameter 'speed'.*known parameters: place, robot"):

        @action
        def bad(speed):
            pass


def test_modules_of_the_folder_may_import_each_other(tmp_path):
    folder = write(tmp_path, "acts.py", "import acts_helper\ndef go():\n    return acts_helper.T\n")
    write(tmp_path, "acts_helper.py", "T = 'T7'\n")
    write(tmp_path, "deep/er.py", "def go():\n    return 'T8'\n")
    assert load_action(folder, "acts.go")(context()).transition == "T7"
    assert load_action(folder, "deep.er.go")(context()).transition == "T8"


def test_a_module_that_another_thread_is_loading_is_waited_for(tmp_path, monkeypatch):
    begun, go_on = threading.Event(), threading.Event()
    monkeypatch.setattr(builtins, "gspn_test", (begun, go_on), raising=False)
    text = "gspn_test[0].set()\ngspn_test[1].wait(60)\ndef go():\n    return 'T7'\n"
    folder = write(tmp_path, "slow.py", text)
    loaded = []
    threads = [
        threading.Thread(target=lambda: loaded.append(load_action(folder, "slow.go")))
        for _ in range(2)
    ]
    threads[0].start()
    assert begun.wait(60)
    threads[1].start()
    threads[1].join(0.2)  # time to find the module half loaded
    go_on.set()
    for thread in threads:
        thread.join(60)
    assert [action(context()).transition for action in loaded] == ["T7", "T7"]


def test_two_plans_may_have_modules_of_one_name(tmp_path):
    one = write(tmp_path / "one", "actions.py", "def go():\n    return 'T1'\n")
    two = write(tmp_path / "two", "actions.py", "def go():\n    return 'T2'\n")
    assert load_action(one, "actions.go")(context()).transition == "T1"
    assert load_action(two, "actions.go")(context()).transition == "T2"


def test_an_installed_module_that_was_allowed_serves_too(tmp_path):
    allow_modules(["posixpath"])
    try:
        action = load_action(str(tmp_path), "posixpath.basename", {"p": "/some/T1"})
    finally:
        allow_modules(())
    assert action(context()).transition == "T1"


@pytest.mark.parametrize(
    "name, text, message",
    [
        ("go", "", "'go' is not a valid function name .write module.function"),
        ("actions.", "", "is not a valid function name"),
        ("no_such_module.go", "", "there is no module 'no_such_module' .searched for"),
        (
            "actions.go",
            "def stay(): pass",
            "actions.py: .*has no 'go' .functions of the module: stay",
        ),
        ("actions.go", "go = 3", "the name does not refer to a function"),
        (
            "actions.go",
            "def go(speed): pass",
            "actions.py: .*'speed' is not one .*known parameters",
        ),
        ("actions.go", "def go(place, /): pass", "cannot be passed by name"),
        ("actions.go", "class go: pass", "has no method __call__"),
        ("actions.go", "x = 1\ndef go(:\n", "actions.py:2: .*SyntaxError"),
        ("actions.go", "import no_such_thing", "actions.py:1: .*ModuleNotFoundError"),
        ("actions.go", "x = 1\n\n1 / 0", "actions.py:3: .*ZeroDivisionError"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, name, text, message):
    folder = write(tmp_path, "actions.py", text)
    with pytest.raises(PlanError, match=message):
        load_action(folder, name)


def test_the_actions_of_a_robot(tmp_path):
    folder = write(tmp_path, "actions.py", "def a(): return 'A'\ndef b(): return 'B'\n")
    net = NetBuilder()
    for place in ("P1", "P2", "P3"):
        net.place(place)
    plan = Plan(
        net.build(),
        actions={"P1": FunctionAction("actions.a", "s1"), "P2": FunctionAction("actions.a", "s2")},
        robots=(RobotSpec("r2", "P1", {"P2": FunctionAction("actions.b", "s2")}),),
        folder=folder,
    )
    assert {p: f.name for p, f in load_actions(plan, "r1").items()} == {
        "P1": "actions.a",
        "P2": "actions.a",
    }
    assert load_actions(plan, "r2")["P2"](context()).transition == "B"


def test_a_module_that_changed_is_loaded_anew_with_all_that_is_beside_it(tmp_path):
    folder = write(
        tmp_path, "acts.py", "import fresh_helper\ndef go():\n    return fresh_helper.T\n"
    )
    write(tmp_path, "fresh_helper.py", "T = 'T1'\n")
    write(tmp_path, "other.py", "def go():\n    return 'T5'\n")
    old, other = load_action(folder, "acts.go"), load_action(folder, "other.go")
    assert load_action(folder, "acts.go").call(context()) == "T1"
    assert load_action(folder, "other.go")._function is other._function
    rewrite(tmp_path / "fresh_helper.py", "T = 'T2'\n")
    assert load_action(folder, "acts.go").call(context()) == "T2"
    assert old.call(context()) == "T1"
    rewrite(tmp_path / "acts.py", "def go():\n    return 'T3'\n")
    assert load_action(folder, "acts.go").call(context()) == "T3"
    rewrite(tmp_path / "acts.py", "def go(:\n")
    with pytest.raises(PlanError, match="SyntaxError"):
        load_action(folder, "acts.go")
    assert old.call(context()) == "T1"
    rewrite(tmp_path / "acts.py", "def go():\n    return 'T4'\n")
    assert load_action(folder, "acts.go").call(context()) == "T4"
