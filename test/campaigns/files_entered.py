#!/usr/bin/env python3
"""How many files of the package a piece of work enters: calls at least one function of them.

    python3 -B test/campaigns/files_entered.py [--files]

Four pieces of work: a firing, from the step of the replica that decides it to the page; an order, from the command
line to the log; a net in PIPE's format, to its report; a plan, to a replica that runs it. The
robots, the page and the operator are in this process and talk through a router of Zenoh. Every
function is counted, on whatever thread it runs: each is loaded with a first line that notes its
file. So what robots do meanwhile is counted too (heartbeats, questions of the page).

``--files`` prints the files.
"""

import argparse
import ast
import contextlib
import importlib.abc
import importlib.machinery
import io
import sys
import tempfile
from pathlib import Path

TESTS = Path(__file__).parents[1]
ROOT = TESTS.parent
PACKAGE = ROOT / "gspn_framework_package"
PATHS = [ROOT, TESTS / "unit" / "team", TESTS / "rostest" / "support"]

entered = set()  # files of the package, from the last call of `counted` on


class Counting(importlib.abc.MetaPathFinder, importlib.machinery.SourceFileLoader):
    """Loads the modules of the package so that each function notes the file that it is in."""

    def __init__(self, name="", path=""):
        super().__init__(name, path)

    def find_spec(self, name, path=None, target=None):
        """Python's own way to a module of the package, with this loader."""
        if name.split(".")[0] != PACKAGE.name or name.split(".")[1:2] in (["msg"], ["srv"]):
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path)
        if spec is not None and isinstance(spec.loader, importlib.machinery.SourceFileLoader):
            spec.loader = Counting(name, spec.origin)
        return spec

    def get_code(self, fullname):
        """Compile it anew: what is cached does not count."""
        return self.source_to_code(self.get_data(self.path), self.path)

    def source_to_code(self, data, path, *, _optimize=-1):
        """Compile a file, with the first lines put in."""
        tree = ast.parse(data)
        file = Path(path).resolve().relative_to(PACKAGE).as_posix()
        compiled = "numba" in file or file.endswith("/kernel.py")  # numba takes no such line
        for node in () if compiled else ast.walk(tree):
            decorators = getattr(node, "decorator_list", [])
            if any(getattr(one, "id", "") == "compiled" for one in decorators):
                continue
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                note = ast.parse("__entered__(%r)" % file).body[0]
                first = 1 if ast.get_docstring(node, clean=False) is not None else 0
                node.body.insert(first, ast.fix_missing_locations(ast.copy_location(note, node)))
                ast.fix_missing_locations(node)
        return compile(tree, path, "exec", dont_inherit=True)


def counted(work, until=lambda: True):
    """Do a piece of work; return the files that were entered until it was done."""
    from zenoh_team import wait_for

    entered.clear()
    work()
    wait_for(until, 60)
    return sorted(entered)


def report_of_a_file():
    """Analyse a net in PIPE's format."""
    from gspn_framework_package.cli.main import main

    net = str(ROOT / "plans" / "measure" / "net.xml")
    with contextlib.redirect_stdout(io.StringIO()):
        return counted(lambda: main(["analyse", net]))


def main():
    """Do each piece of work; print how many files it entered."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", action="store_true", help="print the files too")
    args = parser.parse_args()
    sys.path[:0] = [str(path) for path in PATHS]
    import builtins

    builtins.__entered__ = entered.add
    sys.meta_path.insert(0, Counting())
    found = {"PIPE to report": report_of_a_file()}
    with tempfile.TemporaryDirectory() as folder:
        found.update(team_work(Path(folder)))
    for name, files in found.items():
        print("%-16s %d" % (name, len(files)))
        for file in files if args.files else ():
            print("    " + file)


@contextlib.contextmanager
def from_the_decision():
    """What was entered before the step of the replica that fires first does not count."""
    from gspn_framework_package.execution.agreement.interface import Fired
    from gspn_framework_package.execution.agreement.replica import Replica

    step, fired = Replica.step_all, []

    def noted(replica, *given):
        before = set(entered)
        if not fired:
            entered.clear()
        effects = step(replica, *given)
        fired.extend(effect for effect in effects if isinstance(effect, Fired))
        if not fired:
            entered.update(before)
        return effects

    Replica.step_all = noted
    yield
    Replica.step_all = step


def team_work(folder):
    """The pieces of work of a team."""
    from zenoh_team import Agents, Hub, wait_for

    from gspn_framework_package.cli.main import main as gspn
    from gspn_framework_package.formats.plan_file import read_plan
    from gspn_framework_package.team.plan_examination import check_plan
    from gspn_framework_package.visualizer.hub import Hub as PageHub
    from gspn_framework_package.visualizer.team_watch import TeamWatch
    from gspn_framework_package.visualizer.zenoh_connection import ZenohConnection

    class Team(Agents):
        def start(self, robot, run="monday"):
            if robot == "robot_1":
                check_plan(read_plan(str(self.folder)), print)
            super().start(robot, run)

    found = {}
    with contextlib.ExitStack() as undo:
        hub = Hub()
        undo.callback(hub.close)
        team = []
        undo.callback(lambda: team and team[0].close())
        found["plan to replica"] = counted(
            lambda: team.append(Team(hub, folder / "meeting", robots=1))
        )
        agents = team[0]
        agents.wait_for_team()
        connection = ZenohConnection(hub.access("ann"), "monday")
        watch = TeamWatch(agents.plan, connection, "monday")
        page = PageHub("", watch._follower.board({}))
        undo.callback(watch.end)
        watch.begin(page)
        wait_for(lambda: page.board().status["running"], 60)
        log = folder / "meeting" / "logs" / "monday" / "robot_1.jsonl"
        order = ["pause", "--connect", hub.endpoint, "--run", "monday"]
        with contextlib.redirect_stdout(io.StringIO()):
            found["order to log"] = counted(
                lambda: gspn(order), lambda: '"pause"' in log.read_text().lower()
            )
        with contextlib.redirect_stdout(io.StringIO()):
            gspn(["resume", *order[1:]])
        before = page.board().n
        undo.enter_context(from_the_decision())
        found["firing to page"] = counted(
            agents.let_them_meet,
            lambda: any(e["k"] == "fire" for e in page.events(before, before + 100, 100)),
        )
    return found


if __name__ == "__main__":
    main()
