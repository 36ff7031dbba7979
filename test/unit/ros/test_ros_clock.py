"""The clock by which the times of a plan pass in a simulation."""

import queue
import threading
import time

import pytest

pytest.importorskip("rospy")

import rospy

from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.ros.ros_clock import LOOK_EVERY, STANDS_AFTER, RosCancellation, RosClock
from gspn_framework_package.team.job_runner import JobRunner
from gspn_framework_package.team.jobs import CANCELLED, Job


@pytest.fixture
def simulated(monkeypatch):
    """Sets simulated time, in seconds."""
    shown = [0.0]
    monkeypatch.setattr(rospy.rostime, "is_wallclock", lambda: False)
    monkeypatch.setattr(rospy, "get_time", lambda: shown[0])
    return lambda seconds: shown.__setitem__(0, seconds)


def test_time_passes_as_the_simulation_says_and_never_back(simulated):
    clock = RosClock()
    begin = clock.seconds()
    simulated(1000.0)  # the first /clock
    assert clock.seconds() == begin
    simulated(1004.0)
    assert clock.seconds() - begin == 4.0
    simulated(500.0)
    assert clock.seconds() - begin == 4.0
    assert (clock.times_back, clock.back_by) == (1, 504.0)
    simulated(501.0)
    assert clock.seconds() - begin == 5.0
    assert clock.look_at(begin + 9.0, 70.0) == 70.0 + LOOK_EVERY


def test_functions_sleep_in_simulated_time(simulated):
    simulated(1000.0)
    slept = queue.Queue()
    cancellations = [RosCancellation(), RosCancellation()]
    for number, cancellation in enumerate(cancellations):
        threading.Thread(
            target=lambda n=number, c=cancellation: slept.put((n, c.wait(5.0))), daemon=True
        ).start()
    with pytest.raises(queue.Empty):
        slept.get(timeout=0.2)
    cancellations[0].cancel()
    assert slept.get(timeout=30) == (0, True)
    simulated(1004.0)
    with pytest.raises(queue.Empty):
        slept.get(timeout=0.2)
    simulated(1005.5)
    assert slept.get(timeout=30) == (1, False)


def test_simulated_time_that_stands_still_is_named(simulated, monkeypatch):
    here = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: here[0])
    clock = RosClock()
    simulated(1000.0)
    assert clock.stands() == ""
    here[0] += STANDS_AFTER - 0.1
    assert clock.stands() == ""
    here[0] += 0.1
    assert "stands still (/clock)" in clock.stands()
    simulated(1000.1)
    assert clock.stands() == ""
    monkeypatch.setattr(rospy.rostime, "is_wallclock", lambda: True)
    here[0] += 60.0
    assert clock.stands() == ""


def test_the_clock_is_that_of_the_machine_where_time_is_not_simulated():
    clock = RosClock()
    assert abs(clock.seconds() - time.monotonic()) < 5.0
    assert clock.look_at(72.0, 70.0) == 72.0


class UntilCancelled(Job):
    def run(self, prepared, attempt):
        attempt.begin()
        attempt.is_cancelled.wait(20.0)
        return CANCELLED


def test_a_job_waits_and_times_out_by_its_clock(simulated):
    simulated(1000.0)
    clock, ended = RosClock(), []
    clock.seconds()
    runner = JobRunner(
        {"P": UntilCancelled("P", FunctionAction("work.wait", "P"))},
        lambda place: 30.0,
        lambda function, *arguments: None,
        ended.append,
        clock=clock,
    )
    now = time.monotonic()
    runner.start(StartAction("robot_1", "P", 1, 1, 2, 5.0), now)
    assert runner.poll(now + 100.0) == now + 100.0 + LOOK_EVERY
    assert runner.doing() == "waits before attempt 2"
    simulated(1006.0)
    runner.poll(now)
    deadline = time.monotonic() + 20.0
    while runner.poll(now) is None:  # until it has begun
        assert time.monotonic() < deadline
    simulated(1040.0)
    runner.poll(now)
    assert [end.reason for end in ended] == ["timeout"]
    runner.close()
