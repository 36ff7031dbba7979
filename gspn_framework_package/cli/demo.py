"""``gspn demo``: starts a team of robots on a running ROS master and shows the run live."""

from __future__ import annotations

import argparse
import contextlib
import glob
import os
import shutil
import signal
import socket
import sys
import threading
import time
import types
import uuid
import webbrowser
from typing import Any, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.cli.team_client import require_ros
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import Plan

LAST_LINES = 8
"""Number of firings that the live view shows."""

WORLD_SPEED = 3.0
"""Maximum speed of the simulated room relative to real time: a TurtleBot3 drives too slowly to
watch."""

START_TIME = 120.0
"""Seconds within which the first transition must fire."""


OPTIONS: Arguments = {
    Argument("--robots", "N", numbers.robots, 3): "number of robots (3)",
    Argument("--plan", "FOLDER", required=True): "folder of the plan",
    Argument("--seconds", "S", numbers.seconds, 0): (
        "end S seconds after the first firing; 0 to run until Ctrl-C"
    ),
    "--headless": "open no window (the page is still served)",
    "--no-world": "no simulated room, even if the plan has one",
    Argument("--port", "P", numbers.port, 8090): (
        "port of the page; if it is taken, the next free one is used (8090)"
    ),
}

EPILOG = "Exit codes: 0 the team ran, 1 a node died or nothing fired, 2 not a plan or wrong usage."


def run(args: argparse.Namespace) -> int:
    """Start the team, show the run, shut the team down, and report how the run went."""
    room = None if args.no_world else find_room(args.plan)
    path = room.plan if room else args.plan
    plan = read_plan(path).for_robots(args.robots)
    demo = _Demo(
        plan, path, args.seconds, room, _free_port(args.port), _has_display() and not args.headless
    )
    try:
        demo.start()
        demo.show()
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # a second signal ends it at once
        demo.end()
    return demo.summary()


class PlanRoom(NamedTuple):
    """A room in a plan's folder: the room's file, and the plan whose robots drive in it."""

    world: str
    plan: str


def find_room(folder: str) -> Optional[PlanRoom]:
    """Return the room of a plan's folder, which is a ``room.json`` beside one YAML file; None if
    there is none."""
    plan = os.path.join(folder, "room.json")
    worlds = sorted(glob.glob(os.path.join(glob.escape(folder), "*.yaml")))
    return (
        PlanRoom(os.path.abspath(worlds[0]), plan)
        if len(worlds) == 1 and os.path.isfile(plan)
        else None
    )


def _free_port(first: int) -> int:
    """Return the first free port from ``first`` on."""
    for port in range(first, first + 100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) != 0:
                return port
    raise UsageError(
        "no port from %d to %d is free" % (first, first + 99), hint="choose another with --port"
    )


def _has_display() -> bool:
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class _Demo:
    def __init__(
        self,
        plan: Plan,
        path: str,
        seconds: float,
        room: Optional[PlanRoom],
        port: int,
        open_browser: bool,
    ) -> None:
        self._plan, self._path, self._seconds = plan, os.path.abspath(path), seconds
        self._room, self._port, self._open_browser = room, port, open_browser
        self._run = "demo_" + uuid.uuid4().hex[:8]
        self._ending = threading.Event()
        self._interrupted = False
        self._died: List[str] = []
        self._launch: Any = None
        self._monitor: Any = None
        self._began = time.monotonic()
        self._first: Optional[float] = None
        self._ended = self._began

    def start(self) -> None:
        """Launch the team; from now on, signals end the demo."""
        require_ros()
        import roslaunch
        import rospkg
        import rospy

        from gspn_framework_package.ros.team_monitor import TeamMonitor
        from gspn_framework_package.ros.transport.registration import require_master

        require_master()
        rospy.init_node("gspn_demo", anonymous=True, disable_signals=True)
        robots = [
            (robot.name, "/robot_%d" % number, robot.place)
            for number, robot in enumerate(self._plan.robots, 1)
        ]
        self._monitor = TeamMonitor(robots, self._run)
        folder = os.path.join(rospkg.RosPack().get_path("gspn_framework_package"), "launch")
        files = [
            (os.path.join(folder, name), words) for name, words in self._launch_files(len(robots))
        ]
        run_id = rospy.get_param("/run_id", None) or str(uuid.uuid4())
        roslaunch.configure_logging(run_id)
        roslaunch.core.clear_printlog_handlers()
        with _silent():
            self._launch = roslaunch.parent.ROSLaunchParent(
                run_id,
                files,
                process_listeners=[types.SimpleNamespace(process_died=self._node_ended)],
                force_log=True,
                show_summary=False,
            )
            self._launch.start(auto_terminate=False)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, lambda *_: self._interrupt())
        where = ""
        if self._room:
            world = os.path.basename(self._room.world)
            where = " in %s, up to %g times real time" % (world, WORLD_SPEED)
        print("%s: %d robots%s, run %s" % (self._plan.name, len(robots), where, self._run))
        address = "http://127.0.0.1:%d/" % self._port
        print("the page: %s" % address, flush=True)
        if self._open_browser:
            threading.Thread(target=self._browse, args=(address,), daemon=True).start()

    def _launch_files(self, robots: int) -> List[Tuple[str, List[str]]]:
        """Return the launch files of the demo, with their arguments: the team, the page, the
        room."""
        team = ["plan:=" + self._path, "robots:=%d" % robots, "run:=" + self._run]
        files = [("team.launch", team), ("visualizer.launch", [*team, "port:=%d" % self._port])]
        if self._room is not None:
            speed = "real_time_factor:=%g" % WORLD_SPEED
            files.append(
                ("world.launch", ["world:=" + self._room.world, "robots:=%d" % robots, speed])
            )
        return files

    def _interrupt(self) -> None:
        self._interrupted = True
        self._ending.set()

    def _browse(self, address: str) -> None:
        """Open the browser as soon as the page responds."""
        while not self._ending.wait(0.2):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self._port)) == 0:
                    webbrowser.open(address)
                    return

    def _node_ended(self, name: str, code: Optional[int]) -> None:
        """Handle the end of a node; runs on roslaunch's thread."""
        if self._ending.is_set():
            return
        name = name.rsplit("-", 1)[0]
        # roslaunch sees all robots as one process, which exits when their run is over; no other
        # process exits by itself
        over = name.startswith("gspn_team") and (
            not code or self._monitor.ended and not self._monitor.fault
        )
        if not over:
            self._died.append(name)
        self._ending.set()

    def show(self) -> None:
        """Show the run until the time is up, a signal arrives, or the run is over."""
        view = _Screen(self) if sys.stdout.isatty() else _Lines(self)
        while not self._ending.wait(0.25):
            now = time.monotonic()
            if self._first is None and self._monitor.firings:
                self._first = now
            if self._first is None:
                if now > self._began + START_TIME:
                    break
            elif self._seconds and now >= self._first + self._seconds:
                break
            view.draw(now)
        self._ended = time.monotonic()
        self._ending.set()
        view.draw(self._ended)

    def end(self) -> None:
        """Shut down every node, and wait until all have exited."""
        self._ending.set()
        if self._launch is not None:
            with _silent():
                self._launch.shutdown()
            self._forget_parameters()

    def _forget_parameters(self) -> None:
        """Remove the demo's parameters from a master that keeps running; a stopped simulated clock
        would block every other node."""
        import rospy

        for name in ("/use_sim_time", "/room") if self._room is not None else ():
            # the master may be gone already, which is fine
            with contextlib.suppress(Exception):
                rospy.delete_param(name)

    def summary(self) -> int:
        """Print how the run went, and return the exit code."""
        monitor = self._monitor
        if monitor.ended:
            print("\nthe run is over: %s" % monitor.ended, end="")
        seconds = self._ended - (self._first or self._ended)
        print("\n%d firings in %.1f s" % (monitor.firings, seconds), end="")
        print(", %.1f a second" % (monitor.firings / seconds) if seconds > 0 else "")
        for name in monitor.doing:
            print("  %-12s moved %d times" % (name, monitor.moves[name]))
        for name, count in monitor.transitions.most_common(5):
            print("  %-32s fired %d times" % (name, count))
        for name in self._died:
            print("error: the node %s died; see its log in %s" % (name, _log_folder()))
        if not monitor.firings and self._interrupted:
            print("interrupted before anything fired")
        elif not monitor.firings:
            print(
                "error: nothing fired within %g s; see the logs in %s" % (START_TIME, _log_folder())
            )
        return 1 if self._died or not monitor.firings else 0

    # -- data for the views ------------------------------------------------------------------------

    def robot_lines(self) -> List[str]:
        """Return one line per robot."""
        lines = []
        for name, doing in self._monitor.snapshot().items():
            line = "%-12s %-28s %-8s visit %-5d" % (name, doing.place, doing.state, doing.visit)
            lines.append(line + (" " + doing.waits_for if doing.waits_for else ""))
        return lines

    def headline(self, now: float) -> str:
        """Return a line with the progress of the run."""
        return "%6.1f s  %d firings, %.1f a second" % (
            now - self._began,
            self._monitor.firings,
            self._monitor.rate(),
        )

    def recent(self, since: float) -> Sequence[Tuple[float, str]]:
        """Return the firings after ``since``, with their times in seconds since the start."""
        return [(t - self._began, text) for t, text in self._monitor.recent(since)]


class _Screen:
    """Shows the run on a terminal, redrawing in place."""

    def __init__(self, demo: _Demo) -> None:
        self._demo = demo
        self._drawn = 0

    def draw(self, now: float) -> None:
        demo = self._demo
        width = shutil.get_terminal_size().columns - 1
        recent = ["%8.1f s  %s" % item for item in demo.recent(0)[-LAST_LINES:]]
        lines = [demo.headline(now), "", *demo.robot_lines(), ""]
        lines += recent + [""] * (LAST_LINES - len(recent))
        up = "\033[%dA" % self._drawn if self._drawn else ""
        sys.stdout.write(up + "".join("\033[2K%s\n" % line[:width] for line in lines))
        sys.stdout.flush()
        self._drawn = len(lines)


class _Lines:
    """Shows the run line by line, for files and pipes: at most ten firings per second, and the
    robots' places every five seconds."""

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
            print(
                "\n".join([self._demo.headline(now)] + ["  " + x for x in self._demo.robot_lines()])
            )
        sys.stdout.flush()


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Keep roslaunch, including its threads, from printing."""
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "wb") as null:
        os.dup2(null.fileno(), 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)


def _log_folder() -> str:
    import rospkg

    return str(rospkg.get_log_dir())
