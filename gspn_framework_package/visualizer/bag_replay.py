"""REPLAY of a rosbag with ``fired_transitions``."""

from __future__ import annotations

import contextlib
import json
from typing import Any, Collection, Dict, Iterator, List, Optional, Tuple

from gspn_framework_package.formats.source import open_file
from gspn_framework_package.model.errors import GspnError, LogError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer.activity import Activity
from gspn_framework_package.visualizer.board import Event, note_event
from gspn_framework_package.visualizer.documents import Document, Folder
from gspn_framework_package.visualizer.fired_follower import FiredFollower, FiredMessage
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.poses import (
    MAP_TYPE,
    PoseTrack,
    RobotPose,
    map_to_json,
    pose_sources,
    robot_pose,
)

TYPE = "gspn_framework_package/FiredTransition"

TEXT_TYPE = "std_msgs/String"

MOST_EVENTS = 400_000


class BagReplay(Activity):
    """Replays the firings of the first run in a bag. A bag does not contain the plan, which is
    identified by its hash.

    :param path: the bag.
    :param plans: the candidate plans.
    :raises LogError: the file is not a bag, contains no firings, or matches none of the plans.
    :ivar left_out: the names of the plan's other runs in the bag.
    """

    mode = "REPLAY"

    def __init__(self, path: str, plans: List[Plan]) -> None:
        super().__init__()
        with _opened(path) as bag:
            messages = _firings(bag, path)
            wanted, run = messages[0][1].plan, messages[0][1].run
            found = [plan for plan in plans if plan.hash() == wanted]
            if not found:
                raise LogError(
                    "its plan is unknown here",
                    file=path,
                    hint="give the plan with --plan, or put it into the served folder",
                )
            self.plan = found[0]
            self.left_out = sorted({m.run for _, m in messages if m.plan == wanted} - {run})
            self._messages = [(t, m) for t, m in messages if (m.plan, m.run) == (wanted, run)]
            self._others = [t for t, m in messages if m.run == run and m.plan != wanted]
            """Times at which the team fired under other plans, which a bag does not contain."""
            self._names = {name for _, message in self._messages for name in message.robots}
            self._track = _track(bag, self._names, self._messages[0][0])
        if len(self.plan.robots) != len(self._names):
            with contextlib.suppress(GspnError):  # the first message's marking decides then
                self.plan = self.plan.for_robots(max(1, len(self._names)))

    def document(self, title: str) -> Document:
        """The plan of the recorded run, for display."""
        return Document(title, self.plan.net, self.plan)

    def begin(self, hub: Hub) -> None:
        """Pass the firings to the hub."""
        follower = FiredFollower(self.plan)
        run = self._messages[0][1].run
        info: Dict[str, Any] = {"says": "run %s, recorded in a rosbag" % run}
        first = self._messages[0][0]
        board = follower.board({"running": False}, self._names)
        hub.restart(self.mode, board, info, ring=MOST_EVENTS, track=self._track)
        events: List[Event] = []
        t = 0.0
        for stamp, message in self._messages:
            t = round(stamp - first, 4)
            new = follower.take(message, t)
            while follower.lost_track:
                new += follower.give_up("firings are missing in the bag")
                new += follower.retry(t)
            events += [{**event, "t": t} for event in new]
        rest = follower.give_up("firings are missing in the bag")
        while rest:
            events += [{**event, "t": t} for event in rest]
            rest = follower.give_up("firings are missing in the bag")
        if self.left_out:
            text = (
                "the bag also contains other runs of this plan, which are not shown: %s"
                % ", ".join(self.left_out)
            )
            events.append({**note_event("warning", text), "t": t})
        if self._others:
            text = (
                "from %.1f s on, the run follows another plan; a bag does not contain it, so "
                "nothing of it is shown: replay the event log of a robot"
                % (self._others[0] - first)
            )
            events.append({**note_event("warning", text), "t": t})
        hub.publish(*events)


def read_bag(path: str) -> List[Tuple[float, FiredMessage]]:
    """Pairs (seconds, message) of the firings in a bag, in recording order.

    :raises LogError: the file is not a bag, or contains no firings.
    :raises UsageError: ROS's reader of bags is not installed.
    """
    with _opened(path) as bag:
        return _firings(bag, path)


def _firings(bag: Any, path: str) -> List[Tuple[float, FiredMessage]]:
    topics = [topic for topic, kind in _topics(bag).items() if kind == TYPE]
    read = bag.read_messages(topics=topics) if topics else ()
    firings = [(t.to_sec(), message) for _, message, t in read]
    if not firings:
        raise LogError("holds no firings", file=path, hint="record the topic /fired_transitions")
    return firings


def bag_track(path: str, names: Collection[str], begin: float) -> PoseTrack:
    """Where robots were while a bag was recorded; without any poses if it has none.

    :param names: those of the robots. The poses of one are on ``amcl_pose``, or else ``odom``, in a
        namespace that ends in its name; a simulated world publishes those of all.
    :param begin: the time of the bag's clock that is the beginning of the track (s).
    :raises LogError: the file is not a bag, or a message in it cannot be read.
    """
    with _opened(path) as bag:
        return _track(bag, names, begin)


def _track(bag: Any, names: Collection[str], begin: float) -> PoseTrack:
    track, grid = PoseTrack(), None
    robots: Dict[str, RobotPose] = {}
    topics = _topics(bag)
    if topics and bag.get_end_time() < begin:  # of another time, or of a simulated clock
        return track
    world = topics.get("/world/state") == TEXT_TYPE
    sources = {} if world else pose_sources(topics, names)
    for topic, kind in (("/map", MAP_TYPE), ("/world/room", TEXT_TYPE)):
        if topics.get(topic) == kind and world == (kind == TEXT_TYPE):
            sources[topic] = ("", "")
    wanted = [*sources, *(["/world/state"] if world else ())]
    for topic, message, t in bag.read_messages(topics=wanted) if wanted else ():
        if topic == "/map":
            grid = message  # mapping sends it again and again
        elif topic == "/world/room":
            track.room = json.loads(message.data)
        elif topic == "/world/state":
            robots = json.loads(message.data)["robots"]
            track.add(max(0.0, t.to_sec() - begin), robots)
        else:
            name, suffix = sources[topic]
            pose = robot_pose(message, suffix)
            if pose is not None:
                robots[name] = pose
                track.add(max(0.0, t.to_sec() - begin), robots)
    if grid is not None:
        track.room = map_to_json(grid)
    return track


def _topics(bag: Any) -> Dict[str, str]:
    return {name: info.msg_type for name, info in bag.get_type_and_topic_info().topics.items()}


@contextlib.contextmanager
def _opened(path: str) -> Iterator[Any]:
    """An open bag. Whatever cannot be read in it raises a :class:`LogError`."""
    try:
        import rosbag
    except ImportError:
        raise UsageError(
            "rosbags are read with ROS's own reader, which is not installed",
            file=path,
            hint="apt install python3-rosbag",
        ) from None
    try:
        with open_file(path) as file, rosbag.Bag(file) as bag:
            yield bag
    except (rosbag.ROSBagException, OSError, ValueError, EOFError, KeyError, TypeError) as error:
        raise LogError("not a readable rosbag (%s)" % error, file=path) from None


def plans_of(folder: Folder, given: Optional[Plan] = None) -> List[Plan]:
    """The candidate plans for a bag in ``folder``."""
    plans = [given] if given is not None else []
    for entry in folder.entries():
        if entry.kind != "plan":
            continue
        try:
            document = folder.open(entry.path)
        except GspnError:
            continue
        if document.plan is not None:
            plans.append(document.plan)
    return plans
