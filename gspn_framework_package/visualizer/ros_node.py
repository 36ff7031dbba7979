"""The node ``visualizer``: the page for a team on ROS.

Private parameters: ``plan`` (file or folder), ``robots`` (size of the team that begins; 0: as in
the plan), ``run`` (name of the run; "" takes the first that is heard), ``host``, ``port``,
``names`` (further names of this machine, with commas), ``token``, ``viewer_token``, ``token_file``,
``viewers``.

Whoever can reach the master can read parameters: the tokens are taken off it once they have been
read, and do not go to /rosout. ``token_file`` (its first line is the operator's token, its second
the viewers') keeps them off it.
"""

from __future__ import annotations

import os
import sys
from typing import Any, Optional, Tuple

import rospy

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import GspnError, UsageError
from gspn_framework_package.ros.options import launched_file
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.guard import read_tokens
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.ros_watch import RosWatch
from gspn_framework_package.visualizer.serving import DEFAULT_PORT, WebServer
from gspn_framework_package.visualizer.session import Session


def main() -> int:
    """Serve the page until shutdown; rospy in this thread, the web server in others."""
    rospy.init_node("visualizer")
    try:
        server = _server()
    except GspnError as error:
        rospy.logfatal(str(error))
        return error.exit_code
    server.start()
    rospy.loginfo("the page is at %s", server.address)
    # on the terminal, and not in /rosout: it may hold a token
    for role, address in server.invitations.items():
        print("The page is at %s (%s)" % (address, role), flush=True)
    rospy.spin()
    server.stop()
    return 0


def _server() -> WebServer:
    path = _parameter("plan", "")
    if not path:
        raise UsageError("no plan", element="parameter ~plan", hint="the team's plan file")
    plan = read_plan(launched_file(path, "parameter ~plan"))
    robots = int(_parameter("robots", 0))
    if robots:
        plan = plan.for_robots(robots)
    document = Document(_title(path), plan.net, plan, notes=tuple(plan.notes))
    project = Project()
    project.show(Session("live", document, RosWatch(plan, _parameter("run", ""))))
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


def _tokens() -> Tuple[Optional[str], Optional[str]]:
    """The operator's token and the viewers'."""
    path = _parameter("token_file", "")
    given = [_secret("token"), _secret("viewer_token")]
    if not path:
        return given[0], given[1]
    if any(given):
        raise UsageError("parameter ~token_file goes without ~token and ~viewer_token")
    return read_tokens(os.path.expanduser(path))


def _secret(name: str) -> Optional[str]:
    """A parameter that is taken off the parameter server when it is read."""
    value = _parameter(name, "")
    if rospy.has_param("~" + name):
        rospy.delete_param("~" + name)
    return value or None


def _title(path: str) -> str:
    """The end of a path: enough for a viewer, who need not know this machine's folders."""
    return os.path.join(*os.path.abspath(path).split(os.sep)[-2:])


def _parameter(name: str, default: Any) -> Any:
    value = rospy.get_param("~" + name, default)
    return str(value) if isinstance(default, str) else value


if __name__ == "__main__":
    sys.exit(main())
