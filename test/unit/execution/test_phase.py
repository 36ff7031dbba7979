"""What a robot is up to has one vocabulary: its enum, and nothing beside it."""

import ast
import re
from functools import lru_cache
from pathlib import Path

import pytest

import gspn_framework_package
from gspn_framework_package.execution.phase import Phase, phases_to_json
from gspn_framework_package.execution.team_state import RobotState, TeamState, reported_phase
from gspn_framework_package.execution.team_tasks import Task
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.outcome import FAILURES

PACKAGE = Path(gspn_framework_package.__file__).parent
ROOT = Path(__file__).parents[3]
VALUES = {phase.value for phase in Phase if phase.value}
STATES = {phase.report.state for phase in Phase if phase.report.state}
UNMISTAKABLE = {"doing", "inactive", "has left", "has finished", "not heard yet"} | STATES
"""Strings that mean a phase wherever they stand; the others have other uses too."""


def is_phase(node):
    """Whether a node of Python speaks of a phase by name: x.phase, phase, x["phase"], x.get(...)."""
    return any(
        getattr(part, "attr", getattr(part, "id", getattr(part, "value", None))) == "phase"
        for part in ast.walk(node)
        if isinstance(part, (ast.Attribute, ast.Name, ast.Constant))
    )


def literals(*nodes):
    return {
        part.value
        for node in nodes
        for part in ast.walk(node)
        if isinstance(part, ast.Constant) and isinstance(part.value, str)
    }


def second_vocabulary_in_python(nodes):
    """Strings and enums among the nodes of a module that name phases anew."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= {node.value} & UNMISTAKABLE
        elif isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            if any(is_phase(side) for side in sides):
                found |= literals(*sides) & VALUES
        elif isinstance(node, ast.keyword) and node.arg == "phase":
            found |= literals(node.value) & VALUES
        elif isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(is_phase(target) for target in targets):
                found |= literals(node.value) & VALUES
        elif isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values):
                if isinstance(key, ast.Constant) and key.value == "phase":
                    found |= literals(value) & VALUES
            names = literals(*(key for key in node.keys if isinstance(key, ast.Constant)))
            if len(names & VALUES) > 2:
                found |= names & VALUES
        elif isinstance(node, ast.ClassDef) and any(
            getattr(base, "attr", getattr(base, "id", "")) in ("Enum", "IntEnum")
            for base in node.bases
        ):
            members = {
                target.id
                for part in node.body
                if isinstance(part, ast.Assign)
                for target in part.targets
                if isinstance(target, ast.Name)
            }
            if len(members & set(Phase.__members__)) > 1:
                found.add(node.name)
    return found


def second_vocabulary_in_javascript(source):
    found = set()
    for line in source.splitlines():
        code = re.sub(r"(^|\s)(//|/?\*).*", "", line)
        words = {text for _, text in re.findall(r"([\"'`])((?:(?!\1).)*)\1", code)}
        found |= words & UNMISTAKABLE
        if re.search(r"phase", code, re.IGNORECASE):
            found |= words & VALUES
    return found


@pytest.mark.parametrize(
    "source",
    [
        'PHASES = {"Doing": 1}',
        'if robot.phase in ("lost", "left"): pass',
        'show(name, phase="failed")',
        'x = {"name": n, "phase": "done"}',
        'phase: str = "lost"',
        'BADGES = {"lost": 1, "failed": 2, "done": 3}',
        "class State(enum.Enum):\n    DOING = 1\n    WAITING = 2",
    ],
)
def test_a_second_vocabulary_would_be_found_in_python(source):
    assert second_vocabulary_in_python(ast.walk(ast.parse(source)))


@pytest.mark.parametrize(
    "source",
    ['if (robot.phase === "lost") return;', "const a = 'inactive';", 'phase: "done",'],
)
def test_a_second_vocabulary_would_be_found_in_javascript(source):
    assert second_vocabulary_in_javascript(source)


NOT_OURS = {"model name", "success: True"}
"""What other programs print: /proc/cpuinfo and rosservice."""


def sentences(node):
    """The strings of several words that a node of Python compares something with."""
    if isinstance(node, ast.Compare):
        compared = [node.left, *node.comparators]
    elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") in (
        "startswith",
        "endswith",
    ):
        compared = node.args
    else:
        return set()
    return {text for text in literals(*compared) if re.match(r".*[a-z:'] [a-z'%]", text)}


def test_a_branch_on_a_sentence_would_be_found():
    for source in ('"has no value" in error.message', 'text.startswith("waits for")'):
        assert any(sentences(node) for node in ast.walk(ast.parse(source)))


@lru_cache(maxsize=None)
def found_in_python():
    """The phases that modules of the package name anew, and the branches on sentences: both at once,
    since reading the modules takes longer than looking."""
    vocabulary, branches = {}, {}
    for path in PACKAGE.rglob("*.py"):
        name = str(path.relative_to(PACKAGE))
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        again = second_vocabulary_in_python(nodes)
        if again and path != PACKAGE / "execution" / "phase.py":
            vocabulary[name] = again
        for node in nodes:
            again = sentences(node) - NOT_OURS - set(FAILURES)  # these are codes of the log
            if again:
                branches["%s:%d" % (name, node.lineno)] = again
    return vocabulary, branches


@pytest.mark.long
def test_there_is_no_second_vocabulary():
    found = dict(found_in_python()[0])
    for path in (PACKAGE / "visualizer" / "static").rglob("*.js"):
        again = second_vocabulary_in_javascript(path.read_text(encoding="utf-8"))
        if again:
            found[str(path.relative_to(PACKAGE))] = again
    assert found == {}


@pytest.mark.long
def test_nothing_branches_on_a_sentence():
    assert found_in_python()[1] == {}


def test_the_style_sheet_knows_only_phases_that_there_are():
    styles = "".join(path.read_text() for path in (PACKAGE / "visualizer").rglob("*.css"))
    assert set(re.findall(r"\.robot\.([a-z]+)", styles)) <= VALUES
    assert not re.findall(r"\.is-([a-z]+)", styles)


def test_every_state_is_documented_where_ros_tells_it():
    page = (ROOT / "docs" / "ros_interface.md").read_text()
    row = next(line for line in page.splitlines() if line.startswith("| `get_state`"))
    comments = (ROOT / "srv" / "GetState.srv").read_text()
    for state in STATES:
        assert re.search(r"\b%s\b" % state, row), state
        assert "%s:" % state in comments, state


def test_what_logs_and_programs_read_keeps_its_name():
    logged = {phase for phase in Phase if phase.value in ("done", "doing", "failed", "lost")}
    assert logged == {Phase.DONE, Phase.DOING, Phase.FAILED, Phase.LOST}
    assert (Phase.INACTIVE.value, Phase.LEFT.value) == ("inactive", "left")
    for phase in (Phase.DOING, Phase.DONE, Phase.WAITING, Phase.PAUSED, Phase.FAILED):
        assert phase.report.state == phase.name.capitalize()
        assert Phase.of_state(phase.report.state) is phase
    assert Phase.of_state("none of them") is Phase.UNHEARD


def told(phase, paused=False, team_paused=False, ended=None, finished=False):
    state = TeamState((1,), paused=team_paused, ended=ended, finished=finished)
    return reported_phase(state, RobotState("r", 0, phase=phase, paused=paused))


@pytest.mark.parametrize(
    "facts",
    [{}, {"paused": True}, {"team_paused": True}, {"ended": "stopped"}],
    ids=["", "paused", "team paused", "over"],
)
def test_a_failed_robot_is_failed_everywhere(facts):
    assert told(Phase.FAILED, **facts).report.state == "Failed"
    assert told(Phase.FAILED, **facts).report.needs_operator
    assert told(Phase.LOST, **facts).report.state == "Lost"


def test_what_is_reported_of_a_robot():
    assert told(Phase.DOING) is Phase.DOING
    assert told(Phase.DONE) is Phase.WAITING
    assert told(Phase.DOING, paused=True) is told(Phase.DONE, team_paused=True) is Phase.PAUSED
    assert told(Phase.DONE, ended="stopped") is Phase.STOPPED
    assert Phase.STOPPED.report.state == Phase.INACTIVE.report.state == "Inactive"
    assert told(Phase.INACTIVE, ended="the end", finished=True) is Phase.INACTIVE
    assert told(Phase.INACTIVE, ended="stopped") is Phase.STOPPED
    assert reported_phase(TeamState((1,)), None) is Phase.LOST


def test_the_page_is_reported_of_every_phase():
    told = phases_to_json()
    assert set(told["table"]) == {phase.value for phase in Phase}
    assert set(told["named"].values()) <= VALUES
    assert told["table"]["failed"]["tone"] == told["table"]["lost"]["tone"] == "bad"


@pytest.mark.parametrize("phase", ["", "waiting", "paused", "void", "busy", None, [], 3])
def test_a_snapshot_has_only_phases_that_a_log_knows(phase):
    net = NetBuilder("n").place("P", tokens=1).build()
    state = TeamState((1,), {"r": RobotState("r", 0, phase=Phase.INACTIVE)})
    data = state.to_json(net)
    assert TeamState.from_json(data, net, frozenset()) == state
    data["robots"][0]["phase"] = phase
    with pytest.raises(LogError, match="not a snapshot"):
        TeamState.from_json(data, net, frozenset())


@pytest.mark.parametrize("tasks", [None, [["a", {}]], [["a", {}], ["b", {}], ["c", {}]]])
def test_a_snapshot_has_a_task_for_each_token_of_a_queue(tasks):
    net = NetBuilder("n").place("Orders").place("P").build()
    state = TeamState((2, 0), queues={0: [Task("a"), Task("b")]})
    data = state.to_json(net)
    assert TeamState.from_json(data, net, frozenset([0])) == state
    if tasks is None:
        del data["queues"]
    else:
        data["queues"] = {"Orders": tasks}
    with pytest.raises(LogError, match="as many tasks as tokens"):
        TeamState.from_json(data, net, frozenset([0]))


def test_a_snapshot_has_tasks_in_queues_only():
    net = NetBuilder("n").place("P", 1).build()
    data = TeamState((1,), queues={0: [Task("a")]}).to_json(net)
    with pytest.raises(LogError, match="not a queue has tasks"):
        TeamState.from_json(data, net, frozenset())
