"""Actions for the test; what happens in them is seen through these lists."""

import threading

seen = []
ended = []
release = threading.Event()


def instant(place):
    return "T_" + place


def tell(place, robot, feedback, visit, attempt):
    seen.append((place, robot, visit, attempt))
    feedback(1)
    feedback([2, 3])
    return ""


def until_cancelled(visit, is_cancelled):
    seen.append(visit)
    is_cancelled.wait(30)
    ended.append((visit, is_cancelled()))


def breaks():
    raise ValueError("the arm is stuck")


def leaves():
    raise SystemExit(3)


def bad_feedback(feedback):
    feedback("half way")


def hangs():
    release.wait(30)
