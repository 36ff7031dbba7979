"""Random trees of py_trees and random machines of SMACH, as text of modules; what the libraries do
with them, and what their plans do.

Each leaf draws its results from its name, the seed and the number of its visit, so both runs see the
same ones. It writes its name into ``TRACE``, and gives up after ``MOST`` visits.
"""

import random
import sys
import threading
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


def drawn(name, choices, traced=True):
    if traced and len(TRACE) >= %(most)d:
        raise GaveUp
    VISITS[name] += 1
    if traced:
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

_MACHINES = """\
ENDS = ["ok", "bad", "odd"]


class Leaf(smach.State):
    def __init__(self, name, traced=True):
        super().__init__(outcomes=ENDS, input_keys=["seen", "item"], output_keys=["seen"])
        self.name, self.traced = name, traced

    def execute(self, userdata):
        result = drawn(self.name, ["ok", "ok", "bad", "odd"], self.traced)
        if self.traced:
            userdata.seen = userdata.seen + 1
            TRACE.append((userdata.seen, userdata.item))
        return result


def machine():
    return smach.StateMachine(outcomes=ENDS, input_keys=["seen", "item"], output_keys=["seen"])


def create_machine():
%s
    root.userdata.seen, root.userdata.item = 0, "none"
    return root
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


def random_machine(seed: int) -> str:
    """The text of a module with a random machine."""
    draws, lines = random.Random(seed), []  # type: random.Random, List[str]
    outcomes = ("ok", "bad", "odd")

    def new(made: str) -> str:
        variable = "m%d" % len(lines)
        lines.extend(("%s = %s" % (variable, made), "with %s:" % variable))
        return variable

    def add(line: str) -> None:
        lines.append("    " + line)

    def leaf() -> str:
        return 'Leaf("%s")' % draws.choice("ABCD")

    def iterator(inner: str) -> str:
        loops = draws.sample(outcomes, draws.randint(1, 2))
        keys = "input_keys=['seen'], output_keys=['seen']"
        variable = new(
            "smach.Iterator(outcomes=list(ENDS), %s, it=%r, it_label='item', exhausted_outcome=%r)"
            % (keys, "abc"[: draws.randint(0, 3)], draws.choice(outcomes))
        )
        add(
            "smach.Iterator.set_contained_state('each', %s, loop_outcomes=%r, final_outcome_map=%r)"
            % (inner, loops, {"odd": draws.choice(outcomes)})
        )
        return variable

    def concurrence() -> str:
        variable = new(
            "smach.Concurrence(outcomes=ENDS, default_outcome='odd',"
            " outcome_map={'ok': {'L': 'ok', 'R': 'ok'}, 'bad': {'L': 'bad'}},"
            " outcome_cb=lambda ends: drawn(str(sorted(ends.items())), [None]))"
        )
        for side in "LR":
            add("smach.Concurrence.add('%s', Leaf('%s%s', False))" % (side, side, variable))
        return variable

    def state(depth: int) -> str:
        kind = draws.random()
        if depth == 0 or kind < 0.5:
            return leaf()
        if kind < 0.7:
            return machine(depth - 1)
        return iterator(state(depth - 1)) if kind < 0.85 else concurrence()

    def machine(depth: int) -> str:
        labels = ["S%d" % number for number in range(draws.randint(1, 4))]
        states = [state(depth) for _ in labels]
        variable = new("machine()")
        for label, made in zip(labels, states):
            leads = {
                outcome: draws.choice((*labels, *outcomes))
                for outcome in outcomes
                if draws.random() < 0.8
            }
            add("smach.StateMachine.add('%s', %s, transitions=%r)" % (label, made, leads))
        return variable

    lines.append("root = %s" % machine(3))
    head = _HEAD % {"library": "smach", "most": MOST, "seed": seed}
    return head + "\n" + _MACHINES % "\n".join("    " + line for line in lines)


def quiet_smach() -> None:
    """Let SMACH say nothing, and let the one of the package index find what Python 2 had."""
    import smach

    smach.set_loggers(*[lambda text: None] * 4)
    if not hasattr(threading.Thread, "isAlive"):
        threading.Thread.isAlive = threading.Thread.is_alive  # type: ignore[attr-defined]


def plan_of_file(path: Path, robots: int = 1, ticks: bool = False) -> ImportedPlan:
    """The plan of a file, which this process runs."""
    return plan_of_found(str(path), describe_file(str(path), "", ticks), robots)


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


def run_by_smach(path: Path) -> Run:
    """What SMACH does."""
    module = _loaded(path, "the_machine")
    root = module.create_machine()
    try:  # with userdata of its own: by default, all machines of a process share some
        return module.TRACE, root.execute(module.smach.UserData())
    except Exception as error:
        if "GaveUp" not in str(error):
            raise
        return module.TRACE, None


def run_by_plan(made: ImportedPlan, folder: Path) -> Run:
    """What a robot does in the plan, with the actions of its folder."""
    made.write(str(folder))
    actions = _loaded(folder / "actions.py", "the_actions")
    actions.SECONDS_BETWEEN_TICKS = 0  # of trees
    net, marking = made.net, made.net.initial_marking
    ends = {place for place, action in made.plan["actions"].items() if action is None}
    for _ in range(50 * MOST):
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
    return sys.modules["file_of_ann"].TRACE, "runs on"
