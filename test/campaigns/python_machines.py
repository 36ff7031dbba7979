"""Plans of random trees of py_trees and of random machines of SMACH, beside the libraries themselves,
which run the same ones with the same results of the same leaves.

    python3 test/campaigns/python_machines.py --number 500
"""

import argparse
import collections
import itertools
import sys
import tempfile
from pathlib import Path

TEST = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TEST), str(TEST.parent)]

import python_machines as machines

from gspn_framework_package.formats.python_root import RootError
from gspn_framework_package.model.errors import InputError


def differing(library, number, text_of, run, **more):
    """Return the seeds that differ, after a line on what was compared."""
    refused, endings, whole, differ = collections.Counter(), collections.Counter(), 0, []
    with tempfile.TemporaryDirectory() as folder:
        for seed in itertools.count():
            if sum(endings.values()) == number:
                break
            path = Path(folder) / ("file_%d.py" % seed)
            path.write_text(text_of(seed))
            try:
                made = machines.plan_of_file(path, **more)
            except (InputError, RootError) as error:
                refused[str(error).rpartition(".py")[2][:60]] += 1
                continue
            theirs = run(path)
            ours = machines.run_by_plan(made, Path(folder) / ("plan_%d" % seed))
            endings[theirs[1]] += 1
            whole += any("one action" in note for note in made.notes)
            if ours != theirs:
                differ.append(seed)
    print("%s: %d made, refused: %s" % (library, seed, dict(refused) or "none"))
    print(
        "%d compared, %d of them with parts that are one action; endings: %s"
        % (sum(endings.values()), whole, dict(endings))
    )
    print("different: %s" % (differ or "none"))
    return differ


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--number", type=int, default=500, help="that many are compared of each")
    number = parser.parse_args().number
    differ = differing("py_trees", number, machines.random_py_tree, machines.run_by_py_trees)
    trees = (machines.random_py_tree, machines.run_by_py_trees)
    differ += differing("py_trees, from tick to tick", number, *trees, ticks=True)
    machines.quiet_smach()
    differ += differing("SMACH", number, machines.random_machine, machines.run_by_smach)
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main())
