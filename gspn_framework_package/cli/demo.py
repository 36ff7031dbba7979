"""``gspn demo``: starts a team of robots on a running ROS master and shows what happens, live."""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import threading
import time
import uuid
from typing import Any, List, Optional, Sequence, Tuple

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import ExecutionError, GspnError, UsageError
from gspn_framework_package.model.plan import Plan

NAME = "demo"
HELP = "run a plan on a team of robots (needs ROS and a master), and show what happens"

LINES = 8
"""Firings that the live view shows."""

START_TIME = 60.0
"""Seconds within which the first transition must fire, where ``--seconds`` does not end the demo."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    parser.add_argument("--robots", type=int, default=3, metavar="N", help="number of robots (3)")
    parser.add_argument("--plan", required=True, metavar="FOLDER", help="folder of the plan")
    parser.add_argument("--seconds", type=float, default=0, metavar="S", help="end after S seconds; 0: at Ctrl-C")
    parser.add_argument("--headless", action="store_true", help="open no window")
    parser.epilog = "Exit codes: 0 the team ran, 1 a node died or nothing fired, 2 not a plan or wrong usage."


def run(args: argparse.Namespace) -> int:
    """Start the team, show it, end it, and tell how it went."""
    if args.seconds < 0:
        raise UsageError("--seconds must not be below 0")
    plan = read_plan(args.plan).for_robots(args.robots)
    demo = _Demo(plan, args.plan, args.seconds)
    try:
        demo.start()
        demo.show()
    finally:
        demo.end()
    return demo.summary()


class _Demo:
    def __init__(self, plan: Plan, path: str, seconds: float) -> None:
        self._plan, self._path, self._seconds = plan, os.path.abspath(path), seconds
        self._run = "demo_" + uuid.uuid4().hex[:8]
        self._ending = threading.Event()
        self._died: List[str] = []
        self._over: List[str] = []
        self._launch: Any = None
        self._monitor: Any = None
        self._began = time.monotonic()
        self._first: Optional[float] = None
        self._ended = self._began

    def start(self) -> None:
        """Launch the team; the signals end the demo from here on."""
        import rosgraph
        import roslaunch
        import rospkg
        import rospy

        from gspn_framework_package.ros.team_monitor import TeamMonitor

        if not rosgraph.is_master_online():
            raise ExecutionError("no ROS master answers at %s" % rosgraph.get_master_uri(), hint="start roscore")
        rospy.init_node("gspn_demo", anonymous=True, disable_signals=True)
        robots = [(robot.name, "/robot_%d" % number, robot.place) for number, robot in enumerate(self._plan.robots, 1)]
        self._monitor = TeamMonitor(robots, self._run)
        file = os.path.join(rospkg.RosPack().get_path("gspn_framework_package"), "launch", "team.launch")
        words = ["plan:=" + self._path, "robots:=%d" % len(robots), "run:=" + self._run]
        run_id = rospy.get_param("/run_id", None) or str(uuid.uuid4())
        roslaunch.configure_logging(run_id)
        roslaunch.core.clear_printlog_handlers()
        with _silent():
            self._launch = roslaunch.parent.ROSLaunchParent(
                run_id,
                [(file, words)],
                process_listeners=[_Listener(self._node_ended)],
                force_log=True,
                show_summary=False,
            )
            self._launch.start(auto_terminate=False)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, lambda *_: self._ending.set())
        print("%s: %d robots, run %s" % (self._plan.name, len(robots), self._run), flush=True)

    def _node_ended(self, name: str, code: Optional[int]) -> None:
        """On the thread of roslaunch."""
        if self._ending.is_set():
            return
        name = name.rsplit("-", 1)[0]
        (self._died if code else self._over).append(name)
        if self._died or len(self._over) >= len(self._plan.robots):
            self._ending.set()

    def show(self) -> None:
        """Show what happens until the time is up, a signal comes, or the run is over."""
        view = _Screen(self) if sys.stdout.isatty() else _Lines(self)
        deadline = self._began + self._seconds if self._seconds else None
        while not self._ending.wait(0.25):
            now = time.monotonic()
            if self._first is None and self._monitor.firings:
                self._first = now
            if deadline is not None and now >= deadline:
                break
            if deadline is None and self._first is None and now > self._began + START_TIME:
                break
            view.draw(now)
        self._ended = time.monotonic()
        self._ending.set()
        view.draw(self._ended)

    def end(self) -> None:
        """End every node; returns when they have ended."""
        self._ending.set()
        if self._launch is not None:
            with _silent():
                self._launch.shutdown()

    def summary(self) -> int:
        """Print what happened; the exit code."""
        monitor = self._monitor
        seconds = self._ended - (self._first or self._ended)
        print("\n%d firings in %.1f s" % (monitor.firings, seconds), end="")
        print(", %.1f a second" % (monitor.firings / seconds) if seconds > 0 else "")
        for name in monitor.doing:
            print("  %-12s moved %d times" % (name, monitor.moves[name]))
        for name, count in monitor.transitions.most_common(5):
            print("  %-32s fired %d times" % (name, count))
        for name in self._died:
            print("error: the node %s died; see its log in %s" % (name, _log_folder()))
        if not monitor.firings:
            print("error: nothing fired; see the logs in %s" % _log_folder())
        return 1 if self._died or not monitor.firings else 0

    # -- for the views -----------------------------------------------------------------------------

    def robot_lines(self) -> List[str]:
        """One line for each robot."""
        lines = []
        for name, doing in self._monitor.snapshot().items():
            line = "%-12s %-28s %-8s visit %-5d" % (name, doing.place, doing.state, doing.visit)
            lines.append(line + (" " + doing.waits_for if doing.waits_for else ""))
        return lines

    def headline(self, now: float) -> str:
        """How far the run is."""
        return "%6.1f s  %d firings, %.1f a second" % (
            now - self._began, self._monitor.firings, self._monitor.rate()
        )  # fmt: skip

    def recent(self, since: float) -> Sequence[Tuple[float, str]]:
        """The firings since then, with seconds since the start."""
        return [(t - self._began, text) for t, text in self._monitor.recent(since)]


class _Screen:
    """Draws over what it drew before."""

    def __init__(self, demo: _Demo) -> None:
        self._demo = demo
        self._drawn = 0

    def draw(self, now: float) -> None:
        demo = self._demo
        width = shutil.get_terminal_size().columns - 1
        recent = ["%8.1f s  %s" % item for item in demo.recent(0)[-LINES:]]
        lines = [demo.headline(now), "", *demo.robot_lines(), ""]
        lines += recent + [""] * (LINES - len(recent))
        up = "\033[%dA" % self._drawn if self._drawn else ""
        sys.stdout.write(up + "".join("\033[2K%s\n" % line[:width] for line in lines))
        sys.stdout.flush()
        self._drawn = len(lines)


class _Lines:
    """Prints line after line, for files and pipes: at most ten firings a second, and where the
    robots are every five seconds."""

    def __init__(self, demo: _Demo) -> None:
        self._demo = demo
        self._seen = time.monotonic()
        self._robots_at = 0.0

    def draw(self, now: float) -> None:
        news = self._demo.recent(self._seen)
        self._seen = now
        for at, text in news[:3]:
            print("%8.1f s  %s" % (at, text))
        if len(news) > 3:
            print("            and %d more firings" % (len(news) - 3))
        if now >= self._robots_at:
            self._robots_at = now + 5.0
            print("\n".join([self._demo.headline(now)] + ["  " + x for x in self._demo.robot_lines()]))
        sys.stdout.flush()


class _Listener:
    """What roslaunch tells of the nodes."""

    def __init__(self, ended: Any) -> None:
        self._ended = ended

    def process_died(self, name: str, code: Optional[int]) -> None:
        self._ended(name, code)


class _silent:  # noqa: N801  # used like a function
    """Keeps roslaunch from printing, also what its threads print meanwhile."""

    def __enter__(self) -> None:
        sys.stdout.flush()
        self._kept = os.dup(1)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.close(null)

    def __exit__(self, *_: Any) -> None:
        sys.stdout.flush()
        os.dup2(self._kept, 1)
        os.close(self._kept)


def _log_folder() -> str:
    import rospkg

    return str(rospkg.get_log_dir())


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """What ``run_demo`` starts: the verb by itself."""
    parser = argparse.ArgumentParser(prog="gspn demo", description=HELP)
    add_arguments(parser)
    try:
        return run(parser.parse_args(arguments))
    except GspnError as error:
        print("gspn: error: %s" % error, file=sys.stderr)
        return error.exit_code


if __name__ == "__main__":
    sys.exit(main())
