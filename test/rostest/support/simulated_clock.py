"""A /clock that a test sets."""

import contextlib
import threading
import time

import rospy
from rosgraph_msgs.msg import Clock
from waiting import wait_for


class SimulatedClock:
    """Publishes /clock; ``rate`` seconds of it pass in one second."""

    def __init__(self):
        self.now, self.rate = 1000.0, 1.0
        self._publisher = rospy.Publisher("/clock", Clock, queue_size=1)
        threading.Thread(target=self._tick, daemon=True).start()
        wait_for(rospy.get_time, what="the first /clock")

    def _tick(self):
        last = time.monotonic()
        while not rospy.is_shutdown():
            now = time.monotonic()
            self.now += (now - last) * self.rate
            last = now
            with contextlib.suppress(rospy.ROSException):  # the end of the test closes the topic
                self._publisher.publish(Clock(rospy.Time.from_sec(self.now)))
            time.sleep(0.01)
