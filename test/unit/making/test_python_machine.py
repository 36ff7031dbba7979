"""Plans of Python files with machines of SMACH: what a robot does is what the machine does."""

import json
import sys
import types

import pytest

if sys.version_info < (3, 9):  # the tests with old libraries have none of these
    pytest.importorskip("smach")

from python_machines import (
    plan_of_file,
    quiet_smach,
    random_machine,
    run_by_plan,
    run_by_smach,
)

import gspn
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.python_root import RootError
from gspn_framework_package.formats.smach_machine import MachineRun
from gspn_framework_package.model.errors import InputError

HEAD = """\
import smach

def state(*outcomes):
    return smach.CBState(lambda userdata: outcomes[0], outcomes=list(outcomes))

def create_machine():
    m = smach.StateMachine(outcomes=["done", "failed"])
    with m:
"""


@pytest.fixture(name="made")
def _made(tmp_path):
    """Returns a function that makes the plan of a machine; its states begin in line 9 of a file."""
    quiet_smach()

    def make(*lines, **more):
        path = tmp_path / "machine.py"
        path.write_text(HEAD + "".join("        %s\n" % line for line in lines) + "    return m\n")
        return plan_of_file(path, **more)

    return make


def add(label, state, **transitions):
    """The line that adds a state."""
    return "smach.StateMachine.add('%s', %s, transitions=%r)" % (label, state, transitions)


def arcs(made):
    """Transition -> the place that it leads to."""
    net, found = made.net, {}
    for transition in net.transitions:
        here = transition.name.rpartition(": ")[0]
        marking = tuple(int(place.name == here) for place in net.places)
        marking = net.fire(marking, net.transition_number(transition.name))
        (found[transition.name],) = net.named(marking, zeros=False)
    return found


def test_30_random_machines_of_smach_do_what_their_plans_do(tmp_path):
    quiet_smach()
    compared = ended = 0
    for seed in range(40):
        path = tmp_path / ("machine_%d.py" % seed)
        path.write_text(random_machine(seed))
        try:
            plan = plan_of_file(path)
        except InputError:
            continue
        theirs = run_by_smach(path)
        assert run_by_plan(plan, tmp_path / ("plan_%d" % seed)) == theirs, path.read_text()
        compared += 1
        ended += theirs[1] is not None
    assert compared > 30
    assert ended > 25


def test_outcomes_are_transitions_and_containers_are_in_the_arcs(made):
    plan = made(
        add("LOOK", "state('seen', 'not')", seen="TAKE", **{"not": "failed"}),
        "inner = smach.StateMachine(outcomes=['ok'])",
        "with inner: smach.StateMachine.add('GRASP', state('ok', 'again'), transitions={'again': 'GRASP'})",
        add("TAKE", "inner", ok="done"),
    )
    assert arcs(plan) == {
        "LOOK: seen": "TAKE.GRASP",
        "LOOK: not": "failed",
        "TAKE.GRASP: ok": "done",
        "TAKE.GRASP: again": "TAKE.GRASP",
    }


@pytest.mark.parametrize(
    "lines, message",
    [
        (
            [add("A", "state('odd')")],
            "machine.py:7: StateMachine: State machine failed consistency",
        ),
        ([add("A", "state('odd')", odd="B")], "references unknown states: ['B']"),
        ([add("A", "smach.State()")], "machine.py:9: State 'A': it has no outcome"),
        (["pass"], "No initial state set"),
        (
            [
                "i = smach.Iterator(['done'], [], [], it=range(6000), exhausted_outcome='done')",
                "with i: smach.Iterator.set_contained_state('B', state('ok'), loop_outcomes=['ok'])",
                add("A", "i", done="done"),
            ],
            "more than 5000 states",
        ),
    ],
)
def test_what_a_plan_cannot_express_is_named_with_its_line(made, lines, message):
    with pytest.raises(InputError) as told:
        made(*lines)
    assert message in str(told.value)


def test_a_whole_machine_that_would_be_one_action_is_refused(tmp_path):
    path = tmp_path / "machine.py"
    path.write_text(
        "import smach\n\nm = smach.Concurrence(['ok'], 'ok')\n"
        "with m: smach.Concurrence.add('A', smach.State(outcomes=['ok']))\n"
    )
    with pytest.raises(InputError) as told:
        plan_of_file(path)
    assert "machine.py:3: Concurrence: the whole machine would be one action" in str(told.value)


def test_what_is_one_action_or_left_out_is_named_with_its_line(made):
    plan = made(
        "c = smach.Concurrence(outcomes=['ok'], default_outcome='ok')",
        "with c: smach.Concurrence.add('L', state('ok'))",
        add("BOTH", "c", ok="EACH"),
        "i = smach.Iterator(['ok'], ['items'], [], it=lambda: [1], exhausted_outcome='ok')",
        "with i: smach.Iterator.set_contained_state('B', state('ok'), loop_outcomes=['ok'])",
        add("EACH", "i", ok="done"),
        "m.register_start_cb(print)",
    )
    where = [note.rpartition("machine.py:")[2] for note in plan.notes]
    assert where == [
        "7: StateMachine: its callbacks are not called",
        "9: Concurrence 'BOTH': it is one action, with everything in it: its states run at the same time",
        "12: Iterator 'EACH': it is one action, with everything in it: what it iterates over is known "
        "only when it runs",
        "userdata stays in each robot's own machine, and is not data of the plan: items",
    ]


def test_containers_are_left_and_entered_after_states_that_others_ran():
    import smach

    quiet_smach()
    seen = []

    def look(userdata):
        seen.append(userdata.x)
        userdata.x = userdata.x + 1
        return "ok"

    def state():
        return smach.CBState(look, outcomes=["ok"], io_keys=["x"])

    root = smach.StateMachine(outcomes=["ok"])
    root.userdata.x = 5
    inner = smach.StateMachine(outcomes=["ok"], input_keys=["x"], output_keys=["x"])
    with inner:
        smach.StateMachine.add("SERVER", smach.State(outcomes=["ok"]), {"ok": "B"})
        smach.StateMachine.add("B", state(), {"ok": "SERVER_TOO"})
        smach.StateMachine.add("SERVER_TOO", smach.State(outcomes=["ok"]))
    with root:
        smach.StateMachine.add("BEFORE", smach.State(outcomes=["ok"]), {"ok": "INNER"})
        smach.StateMachine.add("INNER", inner, {"ok": "AFTER"})
        smach.StateMachine.add("AFTER", state())
    run = MachineRun(root)
    assert run.execute(("INNER", "B"), lambda stop: None) == "ok"
    assert run.execute(("AFTER",), lambda stop: None) == "ok"
    assert seen == [5, 6]


def test_a_machine_has_no_ticks(made):
    with pytest.raises(RootError, match="has no ticks"):
        made(add("A", "state('done')"), ticks=True)


# --- SimpleActionState, of a smach_ros that has no ROS


class Time:
    """A time of ROS."""

    __slots__ = ("secs", "nsecs")

    def __init__(self, secs=0):
        self.secs, self.nsecs = secs, 0

    def __eq__(self, other):
        return self.secs == other.secs

    def to_sec(self):
        return self.secs


class Goal:
    """A goal of an action server."""

    __slots__ = ("stamp", "frame", "x")

    def __init__(self):
        self.stamp, self.frame, self.x = Time(), "", 0.0


class DriveAction:
    """A type of action servers."""

    _type = "cart_msgs/DriveAction"


class Server:
    """An introspection server, which needs a master."""

    def start(self):
        raise AssertionError("it was started")


@pytest.fixture(name="ros")
def _ros(monkeypatch):
    """A smach_ros in which nothing but a description can be made."""
    import smach

    class SimpleActionState(smach.State):
        """With the parameters of that of smach_ros."""

        def __init__(
            self, action_name, action_spec, goal=None, goal_key=None, goal_slots=(), goal_cb=None,
            result_key=None, result_slots=(), result_cb=None, input_keys=(), output_keys=(),
            outcomes=(), exec_timeout=None,
        ):  # fmt: skip
            raise AssertionError("it made its client")

    library = types.SimpleNamespace(
        SimpleActionState=SimpleActionState, IntrospectionServer=Server, Goal=Goal, Time=Time,
        DriveAction=DriveAction,
    )  # fmt: skip
    known = []
    rospy = types.SimpleNamespace(
        init_node=None, rostime=types.SimpleNamespace(set_rostime_initialized=known.append)
    )
    monkeypatch.setitem(sys.modules, "smach_ros", library)
    monkeypatch.setitem(sys.modules, "rospy", rospy)
    return known


def test_an_action_state_is_bound_to_its_server_with_type_and_goal(made, ros):
    plan = made(
        "import rospy, smach_ros as s; rospy.init_node('cart'); s.IntrospectionServer().start()",
        "goal = s.Goal(); goal.stamp, goal.x = s.Time(7), 2.5",
        add(
            "DRIVE",
            "s.SimpleActionState('drive', s.DriveAction, goal=goal, exec_timeout=s.Time(30))",
            succeeded="ASK",
            aborted="failed",
            preempted="failed",
        ),
        add(
            "ASK",
            "s.SimpleActionState('ask', s.DriveAction, goal_key='where')",
            succeeded="done",
            aborted="failed",
            preempted="failed",
        ),
    )
    assert ros == [True]
    assert plan.plan["actions"]["DRIVE"] == {
        "server": "drive",
        "type": "cart_msgs/DriveAction",
        "goal": {"stamp": "now", "x": 2.5},
        "outcomes": {
            "succeeded": "DRIVE: succeeded",
            "aborted": "DRIVE: aborted",
            "rejected": "DRIVE: aborted",
            "preempted": "DRIVE: aborted",
        },
    }
    assert plan.plan["on_failure"] == {"DRIVE": "fire DRIVE: aborted"}
    assert plan.plan["timeout"] == {"DRIVE": 30}
    # the goal of this one comes from userdata, so the state itself is executed
    assert plan.plan["actions"]["ASK"]["function"] == "actions.State"
    assert arcs(plan) == {
        "DRIVE: succeeded": "ASK",
        "DRIVE: aborted": "failed",
        "ASK: succeeded": "done",
        "ASK: aborted": "failed",
        "ASK: preempted": "failed",
    }


MACHINE = """\
import smach

class Count(smach.State):
    def __init__(self):
        super().__init__(outcomes=["again", "enough"], io_keys=["count"])

    def execute(self, userdata):
        userdata.count = userdata.count + 1
        return "again" if userdata.count < 3 else "enough"

def main():
    m = smach.StateMachine(outcomes=["succeeded"])
    m.userdata.number = 0
    with m:
        inner = smach.StateMachine(outcomes=["enough"], input_keys=["count"], output_keys=["count"])
        with inner:
            smach.StateMachine.add("COUNT", Count(), {"again": "COUNT"})
        smach.StateMachine.add("INNER", inner, {"enough": "REPORT"}, {"count": "number"})
        smach.StateMachine.add(
            "REPORT",
            smach.CBState(lambda userdata: str(userdata.number), outcomes=["3"], input_keys=["number"]),
            {"3": "succeeded"},
        )
    print("it ends with", m.execute())
"""


def test_the_command_writes_a_plan_that_is_checked_analysed_simulated_and_run(tmp_path, capsys):
    (tmp_path / "machine.py").write_text(MACHINE)
    folder = tmp_path / "plan"
    words = ["import", str(tmp_path / "machine.py"), "-o", str(folder), "--run-file"]
    assert main([*words, "--robots", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["places"] == 3
    plan = gspn.load(folder)
    assert plan.check().verdict == "may run"
    assert main(["analyse", str(folder), "--mean-time-to", "succeeded >= 2"]) == 0
    assert main(["simulate", str(folder), "--time", "9", "--replications", "20"]) == 0
    ran = plan.run(seconds=20)
    assert ran.reason == "until: succeeded >= 2"
    each = ["INNER.COUNT: again", "INNER.COUNT: again", "INNER.COUNT: enough", "REPORT: 3"]
    assert sorted(firing["transition"] for firing in ran.firings) == sorted(each * 2)
