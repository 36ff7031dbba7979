"""Random trees of py_trees and random machines of SMACH, as text of modules; what the libraries do
with them, and what their plans do.

Each leaf draws its results from its name, the seed and the number of its visit, so both runs see the
same ones. It writes its name into ``TRACE``, and gives up after ``MOST`` visits.
"""

import random
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any, List, Tuple

from gspn_framework_package.execution.actions import Cancellation
from gspn_framework_package.formats.python_root import describe_file
from gspn_framework_package.making.leaf_plan import ImportedPlan
from gspn_framework_package.making.python_file import plan_of_found

MOST = 60

Run = Tuple[List[Any], Any]
"""The trace of the leaves, and how it ended; None: it was given up."""

_HEAD = """\
import collections
import random

import %(library)s

TRACE, VISITS = [], collections.Counter()


class GaveUp(BaseException):
    pass


def drawn(name, choices):
    if len(TRACE) >= %(most)d:
        raise GaveUp
    VISITS[name] += 1
    TRACE.append(name)
    return random.Random("%%s %%s %%d" %% (%(seed)d, name, VISITS[name])).choice(choices)

"""

_TREES = """\
SUCCESS, FAILURE, RUNNING = (
    py_trees.common.Status.SUCCESS, py_trees.common.Status.FAILURE, py_trees.common.Status.RUNNING
)
POLICIES = py_trees.common.ParallelPolicy


class Leaf(py_trees.behaviour.Behaviour):
    def initialise(self):
        self.result = drawn(self.name, (SUCCESS, SUCCESS, FAILURE))
        self.left = VISITS[self.name] %% 3

    def update(self):
        self.left -= 1
        return RUNNING if self.left >= 0 else self.result


def create_root():
    c, d, b = py_trees.composites, py_trees.decorators, py_trees.behaviours
    return %s
"""


def random_py_tree(seed: int) -> str:
    """The text of a module with a random tree."""
    draws = random.Random(seed)

    def constant() -> str:
        return 'b.%s(name="constant")' % draws.choice(("Success", "Failure"))

    def leaf() -> str:
        return 'Leaf(name="%s")' % draws.choice("ABCD")

    def composite(children: List[str], memory: bool) -> str:
        name = draws.choice(("Sequence", "Selector"))
        return 'c.%s(name="%s", memory=%s, children=[%s])' % (
            name,
            name,
            memory,
            ", ".join(children),
        )

    def node(depth: int) -> str:
        kind = draws.random()
        if depth == 0 or kind < 0.25:
            return constant() if draws.random() < 0.1 else leaf()
        if kind < 0.6:
            return composite([node(depth - 1) for _ in range(draws.randint(1, 4))], True)
        if kind < 0.65:
            return composite([node(depth - 1), constant()], False)
        if kind < 0.75 and depth < 4:
            inner = [leaf() for _ in range(draws.randint(2, 3))]
            if draws.random() < 0.4:
                return composite(inner, False)
            return 'c.Parallel(name="both", policy=POLICIES.%s, children=[%s])' % (
                draws.choice(
                    ("SuccessOnAll(synchronise=%s)" % (draws.random() < 0.5), "SuccessOnOne()")
                ),
                ", ".join(inner),
            )
        name, more = draws.choice(
            (
                ("Inverter", ""),
                ("FailureIsSuccess", ""),
                ("SuccessIsFailure", ""),
                ("PassThrough", ""),
                ("FailureIsRunning", ""),
                ("SuccessIsRunning", ""),
                ("RunningIsFailure", ""),
                ("Timeout", ", duration=60"),
                ("OneShot", ", policy=py_trees.common.OneShotPolicy.ON_COMPLETION"),
                ("Retry", ", num_failures=%d" % draws.choice((1, 2, 3))),
                ("Repeat", ", num_success=%d" % draws.choice((-1, 1, 2, 3))),
                ("Condition", ", status=%s" % draws.choice(("SUCCESS", "FAILURE"))),
            )
        )
        if name in ("RunningIsFailure", "Timeout", "OneShot") and depth == 4:
            name, more = "Inverter", ""
        return 'd.%s(name="%s", child=%s%s)' % (name, name, node(depth - 1), more)

    head = _HEAD % {"library": "py_trees", "most": MOST, "seed": seed}
    return head + "\n" + _TREES % node(4)


def plan_of_file(path: Path, robots: int = 1) -> ImportedPlan:
    """The plan of a file, which this process runs."""
    return plan_of_found(str(path), describe_file(str(path), ""), robots)


def _loaded(path: Path, name: str) -> Any:
    spec = spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = sys.modules[name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run_by_py_trees(path: Path) -> Run:
    """What py_trees does."""
    module = _loaded(path, "the_tree")
    root = module.create_root()
    try:
        for _ in range(50 * MOST):
            root.tick_once()
            if root.status.name != "RUNNING":
                return module.TRACE, root.status.name
    except module.GaveUp:
        return module.TRACE, None
    return module.TRACE, "runs on"


def run_by_plan(made: ImportedPlan, folder: Path) -> Run:
    """What a robot does in the plan, with the actions of its folder."""
    made.write(str(folder))
    actions = _loaded(folder / "actions.py", "the_actions")
    actions.SECONDS_BETWEEN_TICKS = 0
    net, marking = made.net, made.net.initial_marking
    ends = {place for place, action in made.plan["actions"].items() if action is None}
    while True:
        (place,) = net.named(marking, zeros=False)
        if place in ends:
            return sys.modules["file_of_ann"].TRACE, place
        action = made.plan["actions"][place]
        kind = getattr(actions, action["function"].partition(".")[2])
        try:
            transition = kind(**action["settings"])(place, "ann", Cancellation())
        except BaseException as error:
            if "GaveUp" not in type(error).__name__ + str(error):
                raise
            return sys.modules["file_of_ann"].TRACE, None
        marking = net.fire(marking, net.transition_number(transition))
