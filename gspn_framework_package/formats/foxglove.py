"""A layout for Foxglove that shows the messages of a run: what each robot did over time, the tokens
of the places, and the state of the team.

The format is that of the files that Foxglove exports: ``configById`` holds the settings of each
panel, under an id that begins with the panel's type, and ``layout`` is a tree of splits with these
ids as leaves (https://docs.foxglove.dev/docs/visualization/layouts).
"""

from __future__ import annotations

from typing import Any, Dict, Sequence, Union

PLOTTED = 12
"""Maximum number of places to plot; more curves cannot be distinguished."""

Tree = Union[str, Dict[str, Any]]


def foxglove_layout(robots: Sequence[str], places: Sequence[str], namespace: str) -> Dict[str, Any]:
    """The layout as a JSON object.

    :param robots: names of the robots, whose activity is on ``/ROBOT/robot_activity``.
    :param places: names of the places to plot, by their numbers in the net.
    :param namespace: the namespace of the robot whose ``marking`` and ``team_state`` are shown,
        with a leading slash; "" for a run without ROS.
    """
    panels: Dict[str, Dict[str, Any]] = {
        "StateTransitions!places": {
            "foxglovePanelTitle": "Where each robot is",
            "isSynced": True,
            "paths": [_path("/%s/robot_activity.place" % robot, robot) for robot in robots],
        },
        "StateTransitions!states": {
            "foxglovePanelTitle": "What each robot does",
            "isSynced": True,
            "paths": [_path("/%s/robot_activity.state_name" % robot, robot) for robot in robots],
        },
        "Plot!tokens": {
            "foxglovePanelTitle": "Tokens",
            "isSynced": True,
            "showLegend": True,
            "xAxisVal": "timestamp",
            "paths": [
                {**_path("%s/marking.counts[%d]" % (namespace, at), place), "enabled": True}
                for at, place in enumerate(places[:PLOTTED])
            ],
        },
        "RawMessages!team": {
            "foxglovePanelTitle": "The team",
            "topicPath": namespace + "/team_state",
            "diffEnabled": False,
        },
        "RawMessages!firings": {
            "foxglovePanelTitle": "The last firing",
            "topicPath": "/fired_transitions",
            "diffEnabled": False,
        },
    }
    right = _split("column", "RawMessages!firings", "RawMessages!team", 40)
    left = _split(
        "column",
        "StateTransitions!places",
        _split("column", "StateTransitions!states", "Plot!tokens", 50),
        40,
    )
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", left, right, 72),
    }


def _path(value: str, label: str) -> Dict[str, Any]:
    return {"value": value, "label": label, "timestampMethod": "headerStamp"}


def _split(direction: str, first: Tree, second: Tree, percentage: int) -> Dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}
