"""Plans of random behaviour trees, beside BehaviorTree.CPP itself, which runs the same trees with the
same results of the same leaves.

    pip install behaviortreepy        # BehaviorTree.CPP 4 with Python leaves; not in the environment of the tests
    python3 test/campaigns/behaviour_trees.py --trees 2000
"""

import argparse
import sys
import tempfile
from pathlib import Path

TEST = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TEST), str(TEST.parent)]

import behaviortreepy

from behaviour_trees import LEAVES, kinds_of, random_script, random_tree, walked
from gspn_framework_package.making.behaviour_tree import import_tree
from gspn_framework_package.model.errors import InputError

STATUS = behaviortreepy.NodeStatus
TICKS = 10_000


def run_by_cpp(text, script, ends):
    """Return the trace of the tree. A leaf without a result goes on, which only some kinds can."""
    factory, results, trace, over = behaviortreepy.BehaviorTreeFactory(), iter(script), [], []

    def start_of(name):
        def start(*_):
            for result in results:
                trace.append(name)
                return STATUS.SUCCESS if result else STATUS.FAILURE
            over.append(True)
            return STATUS.RUNNING

        return start

    for name in LEAVES:
        if ends:
            factory.register_simple_action(name, start_of(name))
        else:
            factory.register_simple_stateful_action(name, start_of(name), lambda *_: STATUS.RUNNING)
    factory.register_behavior_tree_from_text(text)
    tree = factory.create_tree("Main")
    for _ in range(TICKS):
        status = tree.tick_exactly_once()
        if over:
            return trace, None
        if status != STATUS.RUNNING:
            return trace, status == STATUS.SUCCESS
    return trace, "runs on"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trees", type=int, default=500)
    trees = parser.parse_args().trees
    compared = refused = 0
    differ = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tree.xml"
        for seed in range(trees):
            path.write_text(random_tree(seed))
            try:
                made = import_tree(str(path))
            except InputError:
                refused += 1
                continue
            script = random_script(seed)
            ours = walked(made.net, kinds_of(made.plan), script)
            compared += 1
            if run_by_cpp(path.read_text(), script, ours[1] is not None) != ours:
                differ.append(seed)
    print("%d trees, %d of them refused, %d compared" % (trees, refused, compared))
    print("different: %s" % (differ or "none"))
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main())
