"""Execution nodes as processes of a test: started, killed, stopped, asked."""

import atexit
import glob
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
import unittest
import uuid
import xmlrpc.client

import rosgraph
import rospy
from forked import ForkServer
from waiting import PATIENCE, wait_for

from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.msg import FiredTransition
from gspn_framework_package.srv import Command, GetState

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__)))))

_SERVER = ForkServer(
    "gspn_framework_package.ros.event_sources",
    "gspn_framework_package.ros.node_main",
    "gspn_framework_package.ros.place_servers",
    "gspn_framework_package.ros.service_line",
    "gspn_framework_package.ros.execution_node",
    "gspn_framework_package.ros.transport.master_watch",
)


def start_node(script, namespace, output, name="node", **parameters):
    """Start one of the package's node scripts as a process that writes to the file ``output``."""
    if rospy.has_param("%s/%s" % (namespace, name)):
        rospy.delete_param("%s/%s" % (namespace, name))  # of a node of the same name before
    words = ["_%s:=%s" % (key, json.dumps(value)) for key, value in parameters.items()]
    script = os.path.join(ROOT, "scripts", script)
    words = [script, "__ns:=" + namespace, "__name:=" + name, *words]
    with open(output, "a") as file:
        return _SERVER.start(words, [0, file.fileno(), file.fileno()])


class Robot:
    """The execution node of one robot."""

    def __init__(self, team, name, namespace, **parameters):
        self.team, self.name, self.namespace = team, name, namespace
        self.parameters = parameters
        self.process = None

    def start(self):
        self.output = os.path.join(self.team.folder, self.name + ".out")
        self.process = start_node(
            "gspn_executor",
            self.namespace,
            self.output,
            "executor",
            plan=self.team.plan,
            robot=self.name,
            run=self.team.run,
            log_dir=self.team.folder,
            **self.parameters,
        )
        return self

    def signal(self, number):
        self.process.send_signal(number)

    def kill(self):
        self.signal(signal.SIGKILL)
        self.process.wait()

    def exit_code(self, seconds=20):
        """Wait until the node has ended by itself."""
        return self.process.wait(seconds * PATIENCE)

    def said(self):
        with open(self.output) as file:
            return file.read()

    def call(self, service, service_class, *arguments):
        name = "%s/%s" % (self.namespace, service)

        def answer():
            assert self.process.poll() is None, "%s has ended:\n%s" % (self.name, self.said())
            try:
                rospy.wait_for_service(name, 0.5)
                return rospy.ServiceProxy(name, service_class)(*arguments)
            except (rospy.ROSException, rospy.ServiceException):
                return None

        return wait_for(answer, 20, "an answer of %s" % name)

    def is_heard_by(self, listener):
        """Whether the node knows that ``listener`` is connected to its firings (the listener knows
        it earlier)."""
        try:
            address = rosgraph.Master(rospy.get_name()).lookupNode(self.namespace + "/executor")
            _, _, connections = xmlrpc.client.ServerProxy(address).getBusInfo(rospy.get_name())
        except (OSError, rosgraph.MasterException):
            return False
        return any(
            c[1] == listener and c[2] == "o" and c[4] == "/fired_transitions" for c in connections
        )

    def state(self):
        return self.call("get_state", GetState, "", "")

    def command(self, command, robot="", argument="", run=""):
        return self.call("command", Command, command, robot, argument, run)

    def status(self):
        return json.loads(self.command("status").message)

    @property
    def log_file(self):
        return os.path.join(self.team.folder, self.team.run, self.name + ".jsonl")

    def log(self):
        return read_log(self.log_file)

    def logged_transitions(self):
        """All that has fired, by the robot's log: also what was published before anybody
        listened."""
        slots = (r for r in self.log().records if r["kind"] == "slot")
        return [firing["transition"] for slot in slots for firing in slot["firings"]]


class Team:
    """The robots of one run, in a separate folder; hears all firings."""

    def __init__(self, plan, names, namespaces=None, **parameters):
        self.plan = plan
        self.run = "run_" + uuid.uuid4().hex[:8]
        self.folder = tempfile.mkdtemp(prefix="gspn_rostest_")
        self.fired = []
        self._subscriber = rospy.Subscriber(
            "/fired_transitions", FiredTransition, self._on_fired, tcp_nodelay=True
        )
        self.robots = {}
        for name in names:
            namespace = (namespaces or {}).get(name, "/" + name)
            self.robots[name] = Robot(self, name, namespace, **parameters)

    def _on_fired(self, message):
        if message.run == self.run:
            self.fired.append(message)

    def __getitem__(self, name):
        return self.robots[name]

    def __iter__(self):
        return iter(self.robots.values())

    def start(self):
        for robot in self:
            robot.start()
        return self

    def wait_until_heard(self, seconds=30):
        """Wait until every robot knows that this process listens: what it publishes before is not
        heard."""
        for robot in self:
            wait_for(
                lambda: robot.is_heard_by(rospy.get_name()),
                seconds,
                "a connection to " + robot.name,
            )

    def transitions(self):
        return [message.transition for message in list(self.fired)]

    def wait_for_firings(self, number, seconds=30):
        """Wait until ``number`` more transitions have fired."""
        wanted = len(self.fired) + number
        wait_for(lambda: len(self.fired) >= wanted, seconds, "%d more firings" % number)

    def wait_for_agreement(self, seconds=30, quiet=1.0):
        """Wait until every live replica has reported the same marking at the same position for
        ``quiet`` seconds, and wants nothing more in the log."""
        last, since = None, time.monotonic()

        def answers():
            nonlocal last, since
            states = [r.state() for r in self if r.process.poll() is None]
            pending = sum(r.status()["pending"] for r in self if r.process.poll() is None)
            seen = {(s.slot, s.hash, tuple(s.counts)) for s in states}
            if len(seen) > 1 or pending or seen != last:
                last, since = seen, time.monotonic()
            return states[0] if time.monotonic() - since >= quiet else None

        return wait_for(answers, seconds, "all replicas to rest at one position")

    def close(self):
        """End everything, whatever state it is in."""
        self._subscriber.unregister()
        for robot in self:
            if robot.process is not None and robot.process.poll() is None:
                robot.signal(signal.SIGCONT)
                robot.signal(signal.SIGTERM)
        for robot in self:
            if robot.process is not None:
                try:
                    robot.process.wait(10)
                except subprocess.TimeoutExpired:
                    robot.kill()

    def discard(self):
        shutil.rmtree(self.folder, ignore_errors=True)

    def outputs(self):
        """What all nodes have said, for a test that failed."""
        texts = []
        for path in sorted(glob.glob(os.path.join(self.folder, "*.out"))):
            with open(path) as file:
                texts.append("--- %s\n%s" % (os.path.basename(path), file.read()[-4000:]))
        return "\n".join(texts)

    def verify(self, settled=False):
        """What the history checker says of the logs: None, or the rule that was broken."""
        paths = sorted(glob.glob(os.path.join(self.folder, self.run, "*.jsonl")))
        return verify([read_log(path) for path in paths], settled=settled).violation


def _new_folder():
    """A folder that is removed when the tests of this process are over."""
    folder = tempfile.mkdtemp(prefix="gspn_rostest_plan_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def write_plan(plan, actions=""):
    """Write a plan and its actions.py into a new folder; the folder. Its net gets the robots'
    tokens."""
    robots = plan["robots"]
    started = list(robots.values() if isinstance(robots, dict) else [r["place"] for r in robots])
    for place in plan["net"]["places"]:
        place.setdefault("tokens", started.count(place["name"]))
    folder = _new_folder()
    with open(os.path.join(folder, "plan.json"), "w") as file:
        json.dump(plan, file)
    with open(os.path.join(folder, "actions.py"), "w") as file:
        file.write(actions)
    return folder


def copy_plan(folder, **changes):
    """A copy of a plan's folder with changes to its plan.json; the new folder."""
    copy = os.path.join(_new_folder(), "plan")
    shutil.copytree(os.path.join(ROOT, folder), copy)
    path = os.path.join(copy, "plan.json")
    with open(path) as file:
        plan = json.load(file)
    with open(path, "w") as file:
        json.dump({**plan, **changes}, file)
    return copy


def chain(places, **more):
    """The net of a plan whose exponential transitions T1, T2, ... lead from place to place; the
    last place has no output arcs. ``more``: place -> the place that its T_PLACE leads to."""
    net = {"places": [{"name": p} for p in places], "transitions": [], "arcs": []}

    def lead(name, source, target):
        net["transitions"].append({"name": name, "timed": True, "servers": None})
        net["arcs"] += [{"from": source, "to": name}, {"from": name, "to": target}]

    for number, (source, target) in enumerate(zip(places, places[1:]), 1):
        lead("T%d" % number, source, target)
    for source, target in more.items():
        lead("T_" + source, source, target)
    return net


class RobotTestCase(unittest.TestCase):
    """Ends the teams of a test, and prints what their nodes said if it failed."""

    def run(self, result=None):
        self.teams = []
        before = len(result.failures) + len(result.errors)
        super().run(result)
        for team in self.teams:
            if len(result.failures) + len(result.errors) > before:
                print("%s\n%s" % (self.id(), team.outputs()), flush=True)
            team.discard()

    def tearDown(self):
        for team in self.teams:
            team.close()

    def team(self, plan, names, namespaces=None, actions="", **parameters):
        """A team for a plan: a folder, or a JSON object to be written with its ``actions``."""
        if not isinstance(plan, str):
            plan = write_plan(plan, actions)
        team = Team(plan, names, namespaces, **parameters)
        self.teams.append(team)
        return team
