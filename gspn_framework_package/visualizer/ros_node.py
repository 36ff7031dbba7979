"""The node ``visualizer``: the page for a team on ROS.

Private parameters: ``plan`` (file or folder), ``robots`` (initial size of the team; 0: as in the
plan), ``run`` (name of the run; "": the first one heard), ``host``, ``port``, ``names``
(further names of this machine, separated by commas), ``modules`` (modules whose functions plans may
name), ``token``, ``viewer_token``, ``token_file``, ``viewers``, ``team_key_file`` (the key of the
team, if it has one, so that the page can give orders).

Any machine that reaches the master can read its parameters. The node therefore deletes the tokens
from the parameter server once it has read them, and does not log them to /rosout. With
``token_file`` (the operator's token in the first line, the viewers' in the second) they are never
on the parameter server.
"""

from __future__ import annotations

import os
import sys
from typing import Any, Optional, Tuple

import rospy

from gspn_framework_package.execution.plan_modules import allow_modules, names_of
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import GspnError, UsageError
from gspn_framework_package.ros.options import launched_file
from gspn_framework_package.team.seal import TeamKey, read_team_key
from gspn_framework_package.visualizer.guard import read_tokens
from gspn_framework_package.visualizer.project import project_of_team
from gspn_framework_package.visualizer.ros_watch import RosConnection
from gspn_framework_package.visualizer.serving import DEFAULT_PORT, WebServer
from gspn_framework_package.visualizer.team_watch import TeamWatch


def main() -> int:
    """Serve the page until shutdown: rospy in this thread, the web server in others."""
    rospy.init_node("visualizer")
    try:
        server = _server()
    except GspnError as error:
        rospy.logfatal(str(error))
        return error.exit_code
    server.start()
    rospy.loginfo("the page is at %s", server.address)
    # print it and do not log it to /rosout: it may contain a token
    for role, address in server.invitations.items():
        print("The page is at %s (%s)" % (address, role), flush=True)
    rospy.spin()
    server.stop()
    return 0


def _server() -> WebServer:
    path = _parameter("plan", "")
    if not path:
        raise UsageError("no plan", element="parameter ~plan", hint="the team's plan file")
    allow_modules(names_of(str(_parameter("modules", ""))))
    plan = read_plan(launched_file(path, "parameter ~plan"))
    robots = int(_parameter("robots", 0))
    if robots:
        plan = plan.for_robots(robots)
    watch = TeamWatch(plan, RosConnection(_team_key()), _parameter("run", ""))
    project = project_of_team(path, plan, watch)
    token, viewer_token = _tokens()
    names = [name for name in _parameter("names", "").replace(",", " ").split() if name]
    return WebServer(
        project,
        _parameter("host", "127.0.0.1"),
        int(_parameter("port", DEFAULT_PORT)),
        names,
        token,
        int(_parameter("viewers", 24)),
        viewer_token,
    )


def _team_key() -> Optional[TeamKey]:
    path = _parameter("team_key_file", "")
    return read_team_key(launched_file(path, "parameter ~team_key_file")) if path else None


def _tokens() -> Tuple[Optional[str], Optional[str]]:
    """The operator's and the viewers' token."""
    path = _parameter("token_file", "")
    given = [_secret("token"), _secret("viewer_token")]
    if not path:
        return given[0], given[1]
    if any(given):
        raise UsageError("parameter ~token_file excludes ~token and ~viewer_token")
    return read_tokens(os.path.expanduser(path))


def _secret(name: str) -> Optional[str]:
    """Read a parameter and delete it from the parameter server."""
    value = _parameter(name, "")
    if rospy.has_param("~" + name):
        rospy.delete_param("~" + name)
    return value or None


def _parameter(name: str, default: Any) -> Any:
    value = rospy.get_param("~" + name, default)
    return str(value) if isinstance(default, str) else value


if __name__ == "__main__":
    sys.exit(main())
