"""The client of a running team, for nodes of one's own.

Its methods give the orders of ``gspn``'s verbs, by the same client; a test compares them with the
table of orders.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Callable, Dict, List, NamedTuple, Optional, Union

from gspn_framework_package.cli.team_client import require_ros
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.team.orders import ORDERS, SUBMITTED

if TYPE_CHECKING:
    from gspn_framework_package.msg import FiredTransition
    from gspn_framework_package.team.operator_client import OperatorClient


class TeamFiring(NamedTuple):
    """A firing of a running team.

    :ivar run: the name of the run.
    :ivar transition: the transition that fired.
    :ivar robot: the robot whose request caused it; "" if none did.
    :ivar moves: robot -> its new place.
    :ivar marking: place -> its tokens after the firing; with partial synchronisation, as far as
        the robot knows.
    """

    run: str
    transition: str
    robot: str
    moves: Dict[str, str]
    marking: Dict[str, int]


class Team:
    """A team that runs on ROS.

    A call waits at most 2 s for the robots' status and 7 s for the answer to an order. An order
    raises :class:`RefusedError` if the team does not carry it out. It also does if the robot that
    got it does not answer, and then it is not known whether the team will. Call :meth:`close` in
    the end.

    >>> team = gspn.Team("/", run="shift")  # doctest: +SKIP
    >>> team.pause("robot_2")  # doctest: +SKIP
    >>> team.close()  # doctest: +SKIP

    :param namespace: only the robots in this namespace are asked; "/" for all.
    :param run: the name of the run; "" if there is only one.
    :param key_file: the key of the team, from ``gspn keys shared``; "" for the one that the team
        made for its run on this machine, if there is one.
    :raises InputError: there is no ROS, or the key cannot be read.
    """

    def __init__(self, namespace: str = "/", *, run: str = "", key_file: str = "") -> None:
        require_ros("gspn.Team")
        from gspn_framework_package.ros.service_line import SealedOrders, ServiceLine
        from gspn_framework_package.team.operator_client import CLIENT_TIME, OperatorClient
        from gspn_framework_package.team.seal import read_team_key

        key = read_team_key(key_file) if key_file else None
        self._namespace, self._run = namespace, run
        self._line = ServiceLine(CLIENT_TIME, SealedOrders(key))
        self._client = OperatorClient(self._line)
        self._subscribers: List[Any] = []

    def __repr__(self) -> str:
        return "<Team in %s%s>" % (self._namespace, ", run %s" % self._run if self._run else "")

    def close(self) -> None:
        """End the callbacks, and wait for no more answers.

        >>> team.close()  # doctest: +SKIP
        """
        for subscriber in self._subscribers:
            subscriber.unregister()
        self._subscribers = []
        self._client.close()

    def status(self) -> Dict[str, Optional[Dict[str, Any]]]:
        """What every robot does and waits for: its namespace -> what ``gspn status --json`` prints
        for it, None if it does not answer.

        >>> team.status()["/robot_1"]["waits_for"]  # doctest: +SKIP
        ''

        :raises RefusedError: no ROS master answers, or it knows no robot in the namespace.
        """
        found = self._asked().statuses()
        return {at: s for at, s in found.items() if s is None or self._run in ("", s["run"])}

    def tasks(self) -> Dict[str, Any]:
        """The ``tasks`` of the team, and how the last 100 ``ended``: what ``gspn tasks --json``
        prints.

        >>> [task["id"] for task in team.tasks()["tasks"]]  # doctest: +SKIP
        ['o12']

        :raises RefusedError: no robot answers.
        """
        found: Dict[str, Any] = json.loads(self._told("tasks"))
        return found

    def on_fired(self, callback: Callable[[TeamFiring], None]) -> None:
        """Call back at each firing from now on, until :meth:`close`; ``rospy.init_node`` must have
        been called.

        The callback runs on the thread of rospy that receives the message, as that of any
        subscriber. The network may lose a firing; :meth:`status` has the marking.

        >>> team.on_fired(lambda fired: print(fired.transition))  # doctest: +SKIP

        :param callback: takes the firing. Without a name of the run, it takes those of all runs on
            the ROS master.
        """
        import rospy

        from gspn_framework_package.msg import FiredTransition
        from gspn_framework_package.ros.messages import FIRED_TOPIC

        def heard(message: FiredTransition) -> None:
            if self._run in ("", message.run):
                callback(
                    TeamFiring(
                        message.run,
                        message.transition,
                        message.robot,
                        dict(zip(message.robots, message.robot_places)),
                        dict(zip(message.places, message.counts)),
                    )
                )

        self._subscribers.append(rospy.Subscriber(FIRED_TOPIC, FiredTransition, heard))

    def on_task_ended(self, callback: Callable[[Dict[str, Any]], None]) -> None:
        """Call back at the end of each task from now on, as :meth:`on_fired` does.

        If the robot that decides it dies at that moment, nobody may be called; :meth:`tasks` has
        the last 100 that ended.

        >>> team.on_task_ended(lambda ended: print(ended["id"], ended["outcome"]))  # doctest: +SKIP

        :param callback: takes ``run``, ``id``, ``outcome`` (done, cancelled, late or lost),
            ``why``, ``robot`` (which had it), ``attempts``, ``seconds`` (since it was submitted;
            or None) and ``data``.
        """
        import rospy
        from std_msgs.msg import String

        from gspn_framework_package.ros.messages import TASKS_TOPIC

        def heard(message: String) -> None:
            ended = json.loads(message.data)
            if self._run in ("", ended["run"]):
                callback(ended)

        self._subscribers.append(rospy.Subscriber(TASKS_TOPIC, String, heard))

    def pause(self, robot: str = "", *, stop: bool = False) -> None:
        """Stop all firing until :meth:`resume`, or the firings of one robot.

        >>> team.pause("robot_2", stop=True)  # doctest: +SKIP

        :param robot: its name; "" for the team.
        :param stop: cancel running actions, too; they start again on resume.
        :raises RefusedError: see the class.
        """
        self._order("pause", robot=robot, stop=stop)

    def resume(self, robot: str = "") -> None:
        """End a pause of the team, or of one robot.

        >>> team.resume()  # doctest: +SKIP

        :param robot: its name; "" for the team.
        :raises RefusedError: see the class.
        """
        self._order("resume", robot=robot)

    def submit(
        self,
        transition: str,
        *,
        id: str = "",
        data: Optional[Dict[str, Any]] = None,
        priority: int = 0,
        until: Union[str, int] = 0,
        replace: str = "",
        to: str = "",
        at: Union[str, int] = 0,
        every: Union[str, int] = 0,
    ) -> str:
        """Give the team a task, and return its id.

        If no robot answers, submit it again with the same id: it counts only once.

        >>> team.submit("order", id="o12", data={"pose": [1, 2]}, until="+10m")  # doctest: +SKIP
        'o12'

        :param transition: the transition that takes the task.
        :param id: "" for a new one.
        :param data: a JSON object that actions read as ``task.NAME``.
        :param priority: tasks with a higher one come before others where they wait.
        :param until: if it still waits then, it is late, and nobody takes it any more: ``"+10m"``,
            ``"17:30"``, ``"2026-11-27T17:30"`` or seconds since 1970; 0 for never.
        :param replace: id of a task that is cancelled if the team takes this one.
        :param to: the only robot that may take it, or a capability; "" for any.
        :param at: when it comes in, as for ``until``; 0 for now.
        :param every: after each so much time one like it comes in: ``"90s"``, ``"10m"`` or seconds;
            0 for never.
        :raises InputError: a value is not of this form.
        :raises RefusedError: see the class.
        """
        made = self._order(
            "submit",
            transition=transition,
            id=id,
            data=data,
            priority=priority,
            until=until,
            replace=replace,
            to=to,
            at=at,
            every=every,
        )
        return str(made["id"])

    def cancel(self, id: str) -> None:
        """Cancel a task: it is not to be done, or not any further.

        >>> team.cancel("o12")  # doctest: +SKIP

        :param id: the id of the task.
        :raises RefusedError: see the class.
        """
        self._order("cancel", id=id)

    def give_back(self, id: str) -> None:
        """Have the robot that has a task give it back to its queue.

        >>> team.give_back("o12")  # doctest: +SKIP

        :param id: the id of the task.
        :raises RefusedError: see the class.
        """
        self._order("give_back", id=id)

    def prioritise(self, id: str, priority: int) -> None:
        """Put a task before others, or behind them.

        >>> team.prioritise("o12", 5)  # doctest: +SKIP

        :param id: the id of the task.
        :param priority: a whole number; tasks begin with 0.
        :raises RefusedError: see the class.
        """
        self._order("prioritise", id=id, priority=priority)

    def fire(self, transition: str) -> None:
        """Fire a transition of the environment.

        >>> team.fire("open_shop")  # doctest: +SKIP

        :param transition: its name.
        :raises RefusedError: see the class.
        """
        self._order("fire", transition=transition)

    def set_place(self, robot: str, place: str) -> None:
        """Put a robot into a place; its action there starts.

        >>> team.set_place("robot_2", "Door")  # doctest: +SKIP

        :param robot: its name.
        :param place: the place.
        :raises RefusedError: see the class.
        """
        self._order("set_place", robot=robot, place=place)

    def retry(self, robot: str) -> None:
        """Try the failed action of a robot again.

        >>> team.retry("robot_2")  # doctest: +SKIP

        :param robot: its name.
        :raises RefusedError: see the class.
        """
        self._order("retry", robot=robot)

    def leave(self, robot: str) -> None:
        """Make a robot leave the team, with its token.

        >>> team.leave("robot_2")  # doctest: +SKIP

        :param robot: its name.
        :raises RefusedError: see the class.
        """
        self._order("leave", robot=robot)

    def evict(self, robot: str) -> None:
        """Remove a robot from the team as lost.

        >>> team.evict("robot_2")  # doctest: +SKIP

        :param robot: its name.
        :raises RefusedError: see the class.
        """
        self._order("evict", robot=robot)

    def stop(self, reason: str = "") -> None:
        """End the run of the team.

        >>> team.stop("the shift is over")  # doctest: +SKIP

        :param reason: why, for the log.
        :raises RefusedError: see the class.
        """
        self._order("stop", reason=reason)

    def _order(self, command: str, **given: Any) -> Dict[str, Any]:
        """Give an order; return the values of its fields."""
        kind = ORDERS[command]
        values = kind.checked(given, SUBMITTED)
        self._told(command, values.get("robot", ""), kind.argument(values))
        return values

    def _told(self, command: str, robot: str = "", argument: str = "") -> str:
        """The answer to an order or a question. :raises RefusedError: see the class."""
        done, message = self._asked().order(command, robot, argument, self._run)
        if not done:
            raise RefusedError(message)
        return message

    def _asked(self) -> OperatorClient:
        """The client, of the robots that the ROS master knows now."""
        from gspn_framework_package.ros.service_line import find_nodes

        self._line.nodes = find_nodes(self._namespace)
        return self._client
