"""The private parameters of an execution node."""

from __future__ import annotations

import os
import sys
from typing import Any, Dict, NamedTuple

import rospy
from rospy.client import load_command_line_node_params

from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import Plan, Transport
from gspn_framework_package.ros.transport.registration import master_proxy
from gspn_framework_package.team.log_file import check_run_name, log_path
from gspn_framework_package.team.patience import DEFAULT_PATIENCE, Patience
from gspn_framework_package.team.run_key import AUTO, NONE, make_run_key, run_key_file

ROOM = "/room"
"""The parameter that names the file of the room in which the robots drive; empty without one."""


class NodeOptions(NamedTuple):
    """The private parameters of an execution node, by name."""

    plan: str = ""
    """The plan's folder or file."""
    robot: str = ""
    """Name of the robot, as in the plan."""
    number: int = 0
    """Instead of ``robot``: the number of the robot in the plan, from 1."""
    robots: int = 0
    """Size of the team; 0 for the plan's."""
    place: str = ""
    """The place where a robot that is not in the plan joins the running team."""
    prefix: str = "robot_"
    """For a whole team: the prefix of the robots' namespaces; the robot's number follows it."""
    run: str = "run"
    """Name of the run. The robots of one run agree among themselves, and a node that restarts with
    the same run name continues where it was."""
    log_dir: str = ""
    """Folder of the logs, ``LOG_DIR/RUN/ROBOT.jsonl``; by default ``~/.ros/gspn``."""
    place_servers: bool = True
    """Whether this node serves the plan's Python actions itself."""
    place_server_nodes: bool = False
    """For a team of processes: whether each robot's place servers run as a separate node."""
    respawn: bool = False
    """For a team of processes: whether a node is restarted when it dies."""
    direct_actions: bool = True
    """Whether goals for this node's own place servers are passed to them inside the process;
    otherwise they go over topics, as to any other action server."""
    allow_commands: bool = False
    """Whether the plan may run programs on this computer (actions with ``command``)."""
    modules: str = ""
    """Installed modules, packages or folders whose functions plans may name in addition to those in
    their own folders, separated by commas."""
    check: bool = True
    """Whether the plan is checked before the robot moves."""
    room_plan: str = ""
    """The plan to use instead if there is a room, that is, if the parameter ``/room`` names one."""
    transport: str = ""
    """What carries the messages between the robots: ``ros``, or ``zenoh`` (see ``router``); "" for
    the plan's choice (see :meth:`for_plan`)."""
    router: str = ""
    """With ``zenoh``: endpoints of routers, or of robots that listen, separated by spaces."""
    keys: str = ""
    """With ``zenoh``: the folder of this robot's keys, or its parent folder; "" if the team has
    none."""
    team_key_file: str = ""
    """With ``ros``: a file with the key that the robots and operators of the team share; ``auto``
    for a key that the team makes for its run; "" for that key if it is on this machine; ``none``
    for no key."""
    stay: bool = False
    """Whether the node keeps running and answering after the end of the run."""
    max_connections: int = 32
    """Maximum number of action servers connected at the same time."""
    server_timeout: float = DEFAULT_PATIENCE.server
    """Seconds until an action server that does not answer is reported."""
    acknowledgement_timeout: float = DEFAULT_PATIENCE.acknowledgement
    """Seconds until a goal that no server takes is reported."""
    status_timeout: float = DEFAULT_PATIENCE.status
    """Seconds of silence after which an action server is considered dead."""
    result_timeout: float = DEFAULT_PATIENCE.result
    """Seconds after which the result of an ended goal is considered lost."""

    @property
    def patience(self) -> Patience:
        """The four timeouts of the action client."""
        return Patience(
            server=self.server_timeout,
            acknowledgement=self.acknowledgement_timeout,
            status=self.status_timeout,
            result=self.result_timeout,
        )

    def for_plan(self, plan: Plan) -> NodeOptions:
        """These options, with the plan's transport unless they name one, and with the path of the
        keys.

        :raises UsageError: a router or keys are missing, or an option does not apply to the
            transport.
        """
        transport = self.transport or plan.transport.value
        if transport == Transport.ZENOH.value and not self.router:
            raise UsageError(
                "the transport zenoh needs a router", element="~router", hint="tls/HOST:7447"
            )
        if transport == Transport.ROS.value and (self.router or self.keys):
            raise UsageError(
                "a router and keys cannot be used with the transport ros",
                element="~transport",
                hint="transport:=zenoh, or 'transport': 'zenoh' in the plan",
            )
        if transport == Transport.ZENOH.value and self.team_key_file not in ("", AUTO, NONE):
            raise UsageError(
                "a team key cannot be used with the transport zenoh",
                element="~team_key_file",
                hint="use a folder of keys, from 'gspn keys team'",
            )
        keys = launched_file(self.keys, "~keys") if self.keys else ""
        key_file = self._key_file() if transport == Transport.ROS.value else ""
        return self._replace(transport=transport, keys=keys, team_key_file=key_file)

    def _key_file(self) -> str:
        """The path of the team's key; "" if it has none."""
        if self.team_key_file == AUTO:
            path, is_new = make_run_key(self.run)
            if is_new:
                print(
                    "the team's key is in %s, which only you can read; the page and gspn on this "
                    "machine find it (key:=none: no key)" % path,
                    flush=True,  # the process that forks the robots is not a node, and has no log
                )
            return path
        if self.team_key_file == NONE:
            return ""
        if self.team_key_file:
            return launched_file(self.team_key_file, "~team_key_file")
        path = run_key_file(self.run)
        return path if os.path.lexists(path) else ""

    def log_file(self, robot: str) -> str:
        """The path of the log of ``robot``."""
        return log_path(self.log_dir, self.run, robot)


def read_options() -> NodeOptions:
    """Read the options of this node from the parameter server with one call.

    :raises UsageError: a parameter is unknown, has the wrong type or an invalid value, or no plan
        was given.
    """
    given: Dict[str, Any] = rospy.get_param("~", {})
    if not isinstance(given, dict):
        raise UsageError("the private parameters are not a map", element="~")
    return options_from(given, room=bool(rospy.get_param(ROOM, "")))


def read_options_of(node: str) -> NodeOptions:
    """Read the options of a node that is not initialised (yet), from its parameters and the command
    line.

    :param node: its absolute name.
    :raises UsageError: see :func:`read_options`.
    :raises OSError: no master answers.
    """
    master: Any = master_proxy()
    code, _, given = master.getParam(node, node)
    if code != 1 or not isinstance(given, dict):
        given = {}
    given.update(load_command_line_node_params(sys.argv))
    code, _, room = master.getParam(node, ROOM)
    return options_from(given, room=code == 1 and bool(room))


def launched_file(given: str, parameter: str) -> str:
    """The file or folder that a parameter names; ``~`` is the home folder. A relative path is
    looked up in the folder where the node runs, then where ``roslaunch`` was started, because
    roslaunch runs nodes in a different folder.

    :param given: the value of the parameter.
    :param parameter: the name of the parameter, for messages.
    :raises UsageError: the file is in neither folder.
    """
    path = os.path.expanduser(given)
    shell = os.environ.get("PWD", "")
    for found in (path, os.path.join(shell, path)):
        if os.path.isabs(found) and found == path or os.path.exists(found):
            return found
    raise UsageError(
        "there is no '%s' in %s, where this node runs%s"
        % (given, os.getcwd(), ", nor in %s" % shell if shell not in ("", os.getcwd()) else ""),
        element=parameter,
        hint='give an absolute path, such as "$PWD/%s"' % given,
    )


def options_from(given: Dict[str, Any], room: bool = False) -> NodeOptions:
    """Read the options from a map of parameters.

    :param room: whether there is a room, so that ``room_plan`` is the plan.
    :raises UsageError: see :func:`read_options`.
    """
    fields = {}
    for key, value in given.items():
        if key not in NodeOptions._fields:
            raise UsageError(
                "unknown parameter",
                element="~" + key,
                hint="known parameters: %s" % ", ".join(NodeOptions._fields),
            )
        wanted = type(NodeOptions._field_defaults[key])
        if wanted is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if wanted is str and not isinstance(value, (str, bool)):
            value = str(value)  # YAML turns a run named 42 into a number
        if not isinstance(value, wanted) or wanted is int and isinstance(value, bool):
            raise UsageError("%r is not of type %s" % (value, wanted.__name__), element="~" + key)
        fields[key] = value
    options = NodeOptions(**fields)
    if room and options.room_plan:
        options = options._replace(plan=options.room_plan)
    if not options.plan:
        raise UsageError("no plan was given", element="~plan", hint="name its folder or its file")
    check_run_name(options.run, "~run")
    transports = [transport.value for transport in Transport]
    if options.transport and options.transport not in transports:
        raise UsageError(
            "unknown transport '%s'" % options.transport,
            element="~transport",
            hint="known transports: %s" % ", ".join(transports),
        )
    return options
