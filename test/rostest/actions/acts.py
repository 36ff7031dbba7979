"""Actions for the test; what happens in them is seen through these lists."""

import threading

seen = []
ended = []
release = threading.Event()
heard = threading.Event()


def instant(place):
    return "T_" + place


def tell(place, robot, feedback, visit, attempt):
    seen.append((place, robot, visit, attempt))
    feedback(1)
    feedback([2, 3])
    heard.wait(10)  # feedback and result come on topics of their own, in any order
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


def count_on(data, resumed_from):
    return (
        "T_P1",
        {
            "count": data["robot.count"] + 1,
            "team.note": [data["task.where"], resumed_from],
            "robot.long": "x" * 60000,
        },
    )


def writes_no_data():
    return "T_P1", {"thing": object()}
