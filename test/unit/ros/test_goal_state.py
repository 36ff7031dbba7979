"""The states of a goal: the table is what the picture shows, and no order of events leaves it."""

import re
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rospy")
pytest.importorskip("gspn_framework_package.msg")

from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.ros import goal_state
from gspn_framework_package.ros.action_caller import ActionCaller
from gspn_framework_package.ros.goal_state import (
    TRANSITIONS,
    GoalNews,
    GoalState,
    IllegalTransitionError,
)
from gspn_framework_package.team.clock import Clock


@pytest.mark.parametrize("state", GoalState)
@pytest.mark.parametrize("following", GoalState)
def test_a_goal_goes_only_the_ways_of_the_table(state, following):
    if following in TRANSITIONS[state]:
        assert state.then(following) is following
    else:
        with pytest.raises(IllegalTransitionError, match=state.name):
            state.then(following)


def test_every_state_is_in_the_table_and_in_the_picture():
    assert set(TRANSITIONS) == set(GoalState)
    picture = goal_state.__doc__.split("::")[1]
    for state in GoalState:
        assert re.search(r"^ *%s\b" % state.name, picture, re.MULTILINE), state


def test_every_goal_can_be_cancelled_and_nothing_follows_its_end():
    for state in set(GoalState) - {GoalState.OVER}:
        assert GoalState.OVER in TRANSITIONS[state]
    assert TRANSITIONS[GoalState.OVER] == frozenset()


class Server:
    """A server as its caller sees it, in the state that a test puts it into."""

    server = "/visit"

    def __init__(self):
        self.ready = self.connected = False
        self.quiet = 0.0
        self.sent, self.cancelled = [], []

    @property
    def last_status(self):
        return {"/server": 0.0} if self.ready else {}

    def ready_server(self):
        return "/server" if self.ready else None

    def is_connected(self, caller):
        assert caller == "/server"
        return self.connected

    def silence(self, caller):
        assert caller == "/server"
        return self.quiet

    def period(self, caller):
        return 0.0

    def learn_periods(self):
        pass

    def send(self, goal_id, goal, incarnation, text):
        self.sent.append(goal_id)

    def forget(self):
        pass

    def cancel(self, goal_id):
        self.cancelled.append(goal_id)

    abandon = cancel

    def still_has(self, goal_id):
        return False


class Target:
    place, server, keep, speaks_gspn = "P", "/visit", {}, True

    def new_goal(self, data):
        return object()

    def data_of(self, outcome, text, result):
        return {}

    def transition_of(self, outcome, result):
        return "" if outcome == "succeeded" and result is not None else None


class Caller(Clock):
    """An action caller whose time and server are the test's."""

    def __init__(self, delay=0.0, timeout=60.0):
        self.server, self.ended, self.begun = Server(), [], time.monotonic()
        self.now = self.begun
        self.caller = ActionCaller(
            "robot_1",
            {"P": Target()},
            lambda place: timeout,
            lambda function, *arguments: function(*arguments),
            self.ended.append,
            own_servers={},
            clock=self,
        )
        self.caller._direct["/visit"] = self.server
        self.caller._spare = []
        self.caller.start(StartAction("robot_1", "P", 0, 1, 1, delay), self.begun)

    @property
    def state(self):
        return self.caller._goal.state if self.caller._goal else GoalState.OVER

    def poll(self, seconds=0.0):
        """``seconds`` after the beginning."""
        self.now = self.begun + seconds
        self.caller.poll(self.now)
        return self.state

    def seconds(self):
        return self.now

    def hear(self, what, value=None):
        goal = self.caller._goal
        self.caller._heard(self.server, what, goal.id if goal else "old", value)
        return self.state

    def close(self):
        self.caller.close()


@pytest.fixture
def called():
    callers = []

    def make(*arguments):
        callers.append(Caller(*arguments))
        return callers[-1]

    yield make
    for caller in callers:
        caller.close()


def test_a_goal_goes_all_the_way(called):
    caller = called(5.0)
    assert caller.state is GoalState.DELAYED
    assert caller.caller.doing() == "waits before attempt 1"
    assert caller.poll(5.0) is GoalState.CONNECTING
    assert caller.caller.doing() == "waits for the action server /visit"
    caller.server.ready = caller.server.connected = True
    assert caller.poll(5.1) is GoalState.SENT
    assert caller.caller.doing() == "waits for /visit to accept the goal"
    assert caller.hear(GoalNews.ACKNOWLEDGED, "/server") is GoalState.ACTIVE
    assert caller.caller.doing() == ""
    assert caller.hear(GoalNews.ENDED, ("succeeded", "")) is GoalState.RESULT_DUE
    assert caller.hear(GoalNews.RESULT, ("succeeded", "", object())) is GoalState.OVER
    assert [(ended.result, ended.outcome) for ended in caller.ended] == [("", "succeeded")]
    assert len(caller.server.sent) == 1 and not caller.server.cancelled


def test_a_server_that_is_connected_again_in_time_keeps_its_goal(called):
    caller = called()
    caller.server.ready = caller.server.connected = True
    caller.poll()
    caller.hear(GoalNews.ACKNOWLEDGED, "/server")
    caller.server.connected = False
    assert caller.poll(1.0) is GoalState.RESULT_DUE
    caller.server.connected = True
    assert caller.poll(2.0) is GoalState.RESULT_DUE
    assert caller.poll(4.5) is GoalState.ACTIVE
    caller.server.connected = False
    assert caller.poll(5.0) is GoalState.RESULT_DUE
    assert caller.poll(9.0) is GoalState.OVER
    assert [ended.outcome for ended in caller.ended] == ["server died"]


NEWS = {
    GoalNews.ACKNOWLEDGED: st.just("/server"),
    GoalNews.UNKNOWN: st.none(),
    GoalNews.ENDED: st.sampled_from([("succeeded", ""), ("aborted", "jammed"), ("lost", "")]),
    GoalNews.RESULT: st.sampled_from(
        [("succeeded", "", 1), ("aborted", "jammed", None), ("lost", "", None)]
    ),
    GoalNews.FEEDBACK: st.just(object()),
}
STEPS = st.lists(
    st.one_of(
        *(st.tuples(st.just(what), values) for what, values in NEWS.items()),
        st.tuples(st.just("time"), st.sampled_from([0.01, 1.0, 3.5, 11.0, 70.0])),
        st.tuples(st.sampled_from(["ready", "connected"]), st.booleans()),
        st.tuples(st.just("quiet"), st.sampled_from([0.0, 6.0])),
        st.tuples(st.just("cancel"), st.none()),
    ),
    max_size=25,
)


@settings(max_examples=200, deadline=None)
@given(STEPS, st.sampled_from([0.0, 2.0]), st.sampled_from([None, 60.0]))
def test_in_no_order_of_events_is_the_end_told_twice_or_the_table_left(steps, delay, timeout):
    caller = Caller(delay, timeout)
    now, cancelled = 0.0, False
    try:
        for what, value in steps:
            over = caller.state is GoalState.OVER
            if isinstance(what, GoalNews):
                caller.hear(what, value)
            elif what == "time":
                now += value
                caller.poll(now)
            elif what == "cancel":
                cancelled = cancelled or not over
                caller.caller.cancel()
            else:
                setattr(caller.server, what, value)
            assert not over or caller.state is GoalState.OVER
            ends = 0 if caller.state is not GoalState.OVER or cancelled else 1
            assert len(caller.ended) == ends
    finally:
        caller.close()
