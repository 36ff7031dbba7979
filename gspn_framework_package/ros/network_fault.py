"""The fault ``network`` of the simulated world: the messages of other robots reach a robot late."""

from __future__ import annotations

import contextlib
import json
import queue
import threading
import time
from typing import Any, Callable, Tuple

import rospy
from std_msgs.msg import String


class SlowNetwork:
    """Delays a robot's messages for as long as the world says on ``/world/faults``.

    :param robot: the robot that receives the messages.

    :ivar delay: how long they wait now: seconds of the wall clock, as all times of the agreement.
    """

    def __init__(self, robot: str) -> None:
        self.delay = 0.0
        self._robot = robot
        self._late: queue.SimpleQueue[Tuple[float, Callable[..., None], Any]] = queue.SimpleQueue()
        self._started = False
        self._subscriber = rospy.Subscriber("/world/faults", String, self._heard, queue_size=5)

    def pass_on(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call ``function(*arguments)``, which takes a message: at once, or when its time has come.

        A message may overtake those that came while the delay was longer.
        """
        if self.delay > 0.0:
            self._late.put((time.monotonic() + self.delay, function, arguments))
        else:
            function(*arguments)

    def close(self) -> None:
        """Stop listening to the world."""
        with contextlib.suppress(rospy.ROSException):  # rospy may have closed it already
            self._subscriber.unregister()

    def _heard(self, message: String) -> None:
        active = json.loads(message.data)["active"]
        self.delay = max(
            (
                fault["delay"]
                for fault in active
                if fault["fault"] == "network" and fault["of"] in ("", self._robot)
            ),
            default=0.0,
        )
        if self.delay > 0.0 and not self._started:
            self._started = True
            threading.Thread(target=self._deliver, name="late messages", daemon=True).start()

    def _deliver(self) -> None:
        while True:
            due, function, arguments = self._late.get()
            time.sleep(max(0.0, due - time.monotonic()))
            function(*arguments)
