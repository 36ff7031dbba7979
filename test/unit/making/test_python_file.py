"""Plans of Python files with trees of py_trees: what a robot does is what the tree does."""

import json
import os
import sys
import time

import psutil
import pytest

if sys.version_info < (3, 9):  # the tests with old libraries have none of these
    pytest.importorskip("py_trees")

from python_machines import plan_of_file, random_py_tree, run_by_plan, run_by_py_trees

import gspn
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.python_root import RootError, load_root
from gspn_framework_package.formats.tree_ticks import TreeSteps
from gspn_framework_package.making.python_file import import_python
from gspn_framework_package.model.errors import InputError, UsageError

HEAD = """\
import py_trees
from py_trees import composites as c, decorators as d
from py_trees.behaviours import Periodic, Success

def leaf(name):
    return Periodic(name, 1)

"""


@pytest.fixture(name="made")
def _made(tmp_path):
    """Returns a function that makes the plan of what an expression makes, in line 8 of a file."""

    def make(expression, **more):
        path = tmp_path / "tree.py"
        path.write_text(HEAD + "def create_root(): return %s\n" % expression)
        return plan_of_file(path, **more)

    return make


@pytest.mark.parametrize("ticks, seeds", [(False, 60), (True, 45)])
def test_random_trees_of_py_trees_do_what_their_plans_do(tmp_path, ticks, seeds):
    compared = ended = 0
    for seed in range(seeds):
        path = tmp_path / ("tree_%d.py" % seed)
        path.write_text(random_py_tree(seed))
        try:
            plan = plan_of_file(path, ticks=ticks)
        except (InputError, RootError):
            continue
        theirs = run_by_py_trees(path)
        assert run_by_plan(plan, tmp_path / ("plan_%d" % seed)) == theirs, path.read_text()
        compared += 1
        ended += theirs[1] is not None
    assert compared > 30
    assert ended > 25


def test_each_tick_is_an_action_where_it_is_asked_for(made):
    plan = made("c.Selector('s', False, [leaf('A'), leaf('B')])", ticks=True)
    net, found = plan.net, {}
    for transition in net.transitions:
        here, _, word = transition.name.partition(" ")
        marking = net.fire(net.marking({here: 1}), net.transition_number(transition.name))
        (found[here, word],) = net.named(marking, zeros=False)
    assert found == {
        ("A", "succeeds"): "SUCCESS",
        ("A", "fails"): "B",
        ("A", "goes on"): "A",
        ("B", "succeeds"): "SUCCESS",
        ("B", "fails"): "FAILURE",
        ("B", "goes on"): "A",
    }


def test_a_name_with_a_line_break_is_on_one_line(made, tmp_path):
    plan = made("c.Sequence('s', True, [leaf('Clear\\ntask'), leaf('Clear task')])")
    assert list(plan.plan["actions"])[:2] == ["Clear task", "Clear task 2"]
    plan.write(str(tmp_path / "plan"))


def test_a_tick_whose_outcome_was_not_taken_is_not_done_again(tmp_path):
    path = tmp_path / "tree.py"
    path.write_text(
        HEAD
        + "def create_root(): return c.Sequence('s', False, [Success('A'), Success('B'), leaf('C')])"
    )
    steps = TreeSteps(load_root(str(path), "", "the_tree")[1])
    assert steps.tick("A", (0,)) == ("SUCCESS", False)
    assert steps.tick("A", (0,)) == ("SUCCESS", False)
    with pytest.raises(RuntimeError, match="the robot's tree is elsewhere"):
        steps.tick("C", (2,))
    assert steps.tick("B", (1,)) == ("SUCCESS", False)
    assert steps.tick("C", (2,)) == ("RUNNING", True)


@pytest.mark.parametrize(
    "expression, message",
    [
        ("c.Parallel('p', py_trees.common.ParallelPolicy.SuccessOnAll(), children=[leaf('A')])",
         "tree.py:8: Parallel 'p': the whole tree would be one action: its children run"),
        ("c.Selector('s', False, [leaf('A'), leaf('B')])", "it has no memory"),
        ("Success('done')", "begins with no action"),
        ("c.Sequence('s', True, [leaf('A'), d.Repeat('r', Success('done'), -1)])",
         "tree.py:6: after 'A' it repeats for ever a part that runs no action"),
        ("d.Retry('r', leaf('A'), 6000)", "more than 5000 leaves"),
        ("d.Retry('r', Success('done'), 900000)", "too many nodes"),
    ],
)  # fmt: skip
def test_what_a_plan_cannot_express_is_named_with_its_line(made, expression, message):
    with pytest.raises(InputError) as told:
        made(expression)
    assert message in str(told.value)


def test_a_tree_that_runs_on_without_a_leaf_has_no_ticks(made):
    once = "d.OneShot('o', Success('A'), py_trees.common.OneShotPolicy.ON_COMPLETION)"
    with pytest.raises(RootError, match="running for ever without ticking a leaf"):
        made("d.SuccessIsRunning('r', %s)" % once, ticks=True)


def test_a_part_that_is_one_action_is_named_with_its_line_and_why(made):
    plan = made(
        "c.Sequence('s', True, [leaf('A'), d.Timeout('t', leaf('B'), 3), c.Selector('f', False, [leaf('C'), Success('D')])])"
    )
    assert [note.partition("tree.py:")[2] for note in plan.notes] == [
        "8: Timeout 't' is one action, with everything below it: its time limit is for everything below it"
    ]
    assert list(plan.plan["actions"]) == ["A", "t", "C", "SUCCESS", "FAILURE"]


@pytest.mark.parametrize(
    "text, name, message",
    [
        ("def create_root():\n    return 3\n", "", "'create_root' makes a int, neither a tree"),
        ("x = 1\n", "", "no variables that are a tree or a machine"),
        ("x = 1\n", "make", "there is no 'make' in it"),
        ("x = 1\n\n1 / 0\n", "", "tree.py:3: it fails: ZeroDivisionError: division by zero"),
        ("import nobody_has_it\n", "", "tree.py:1: it needs the Python library 'nobody_has_it'"),
        ("x = (\n", "", "tree.py:1: it fails: SyntaxError"),
        ("def main():\n    raise SystemExit(3)\n", "", "tree.py:2: it fails: SystemExit: 3"),
        ("import os\nos._exit(7)\n", "", "it ended the process that read it (exit code 7)"),
    ],
)
def test_a_file_that_makes_no_tree_is_refused(tmp_path, text, name, message):
    path = tmp_path / "tree.py"
    path.write_text(text)
    with pytest.raises(InputError) as told:
        import_python(str(path), name=name, allowed=True)
    assert message in str(told.value)


def test_a_file_does_not_run_without_the_operators_word(tmp_path, capsys):
    path, ran = tmp_path / "tree.py", tmp_path / "ran"
    path.write_text("open(%r, 'w')\n" % str(ran))
    with pytest.raises(UsageError, match="--run-file, if you trust it"):
        import_python(str(path))
    assert main(["import", str(path), "-o", str(tmp_path / "plan")]) == 2
    assert sorted(os.listdir(tmp_path)) == ["tree.py"]
    assert main(["import", str(path), "-o", str(tmp_path / "plan"), "--run-file"]) == 2
    assert sorted(os.listdir(tmp_path)) == ["ran", "tree.py"]
    capsys.readouterr()


def test_processes_that_a_file_starts_end_with_its_reading(tmp_path):
    path, started = tmp_path / "tree.py", tmp_path / "started"
    path.write_text(
        HEAD + "import subprocess\n"
        "process = subprocess.Popen(['sleep', '1000'])\n"
        "open(%r, 'w').write(str(process.pid))\n"
        "def create_root(): return c.Sequence('s', True, [leaf('A')])\n" % str(started)
    )
    import_python(str(path), allowed=True)
    process = int(started.read_text())
    deadline = time.monotonic() + 10
    while _runs(process):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def _runs(process):
    try:
        return psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_a_tree_without_actions_is_refused_with_its_file(tmp_path, capsys):
    path = tmp_path / "tree.py"
    path.write_text(
        "import py_trees\n\ndef create_root():\n    return py_trees.behaviours.Success('done')\n"
    )
    assert main(["import", str(path), "-o", str(tmp_path / "plan"), "--run-file"]) == 2
    said = capsys.readouterr().err
    assert (
        said.startswith("gspn: error: %s: the behaviour tree" % path) and "put one before" in said
    )
    assert not (tmp_path / "plan").exists()


PATROL = """\
import argparse
import py_trees
from parts import Move

def create_root():
    root = py_trees.composites.Sequence("patrol", memory=True)
    for goal in ("kitchen", "door"):
        root.add_child(py_trees.decorators.Retry("again", Move("go to " + goal), 2))
    return root

def main():
    argparse.ArgumentParser().parse_args()
    print("patrolling")
    py_trees.trees.BehaviourTree(create_root()).tick_tock(100)
"""

PARTS = """\
import py_trees

class Move(py_trees.behaviour.Behaviour):
    def setup(self, **_):
        self.ready = True

    def initialise(self):
        self.left = 2

    def update(self):
        assert self.ready
        self.left -= 1
        if self.left:
            return py_trees.common.Status.RUNNING
        return py_trees.common.Status.SUCCESS
"""


def test_the_command_writes_a_plan_that_is_checked_analysed_simulated_and_run(tmp_path, capsys):
    (tmp_path / "tree.py").write_text(PATROL)
    (tmp_path / "parts.py").write_text(PARTS)
    folder = tmp_path / "plan"
    words = ["import", str(tmp_path / "tree.py"), "-o", str(folder), "--run-file"]
    assert main([*words, "--tree", "main", "--robots", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["places"] == 6
    assert main([*words[:3], str(tmp_path / "ticked"), "--run-file", "--ticks"]) == 0
    (tmp_path / "tree.py").unlink()
    (tmp_path / "parts.py").unlink()
    plan = gspn.load(folder)
    assert plan.check().verdict == "may run"
    assert main(["analyse", str(folder), "--mean-time-to", "SUCCESS + FAILURE >= 2"]) == 0
    assert main(["simulate", str(folder), "--time", "9", "--replications", "20"]) == 0
    ran = plan.run(seconds=20)
    assert ran.reason == "until: SUCCESS + FAILURE >= 2"
    assert sorted(firing["transition"] for firing in ran.firings) == sorted(
        ["go to kitchen succeeds", "go to door succeeds"] * 2
    )
    ticked = gspn.load(tmp_path / "ticked")
    assert ticked.check().verdict == "may run"
    assert [firing["transition"] for firing in ticked.run(seconds=20).firings] == [
        "go to kitchen goes on",
        "go to kitchen succeeds",
        "go to door goes on",
        "go to door succeeds",
    ]
