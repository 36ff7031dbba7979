"""Waiting for conditions: with a deadline, never for a fixed time."""

import os
import time

PATIENCE = float(os.environ.get("GSPN_PATIENCE", "1"))
"""By how much this machine is slower than an idle one of two cores, as run_tests has measured."""


def wait_for(condition, seconds=20.0, what="the condition"):
    """Wait until ``condition()`` is true and return its value; an AssertionError after a
    deadline, which is later on a slow machine. Most of the time passes without looking, since
    conditions that ask nodes take processor time from all of them."""
    seconds *= PATIENCE
    deadline = time.monotonic() + seconds
    while True:
        begin = time.monotonic()
        value = condition()
        if value:
            return value
        now = time.monotonic()
        if now > deadline:
            raise AssertionError("waited %g s for %s; last value: %r" % (seconds, what, value))
        time.sleep(min(0.2, max(0.01, 4 * (now - begin))))
