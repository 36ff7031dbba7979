"""A master that takes connections and answers nothing, or nonsense: nobody waits for it for
ever."""

import socket
import threading

import pytest

pytest.importorskip("rospy")

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import ExecutionError, RefusedError
from gspn_framework_package.ros.service_line import client_on_ros
from gspn_framework_package.ros.transport import registration
from gspn_framework_package.team.operator_client import UnreachableError
from gspn_framework_package.visualizer.ros_watch import RosConnection
from gspn_framework_package.visualizer.team_watch import TeamWatch


@pytest.fixture(params=[b"", b"nonsense\r\n\r\n", b"HTTP/1.1 200 OK\r\n\r\n<methodResponse/>"])
def master(request, monkeypatch):
    """ROS_MASTER_URI is a server that answers these bytes; none: it keeps quiet."""
    listener = socket.create_server(("127.0.0.1", 0))
    connections = []

    def serve():
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            connections.append(connection)
            if request.param:
                connection.recv(65536)
                connection.sendall(request.param)
                connection.close()

    threading.Thread(target=serve, daemon=True).start()
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:%d" % listener.getsockname()[1])
    yield
    listener.shutdown(socket.SHUT_RDWR)
    listener.close()
    for connection in connections:
        connection.close()


@pytest.mark.timeout(60)
def test_an_operators_program_says_that_no_master_answers(master):
    with pytest.raises(ExecutionError, match="no ROS master answers"):
        client_on_ros()
    with pytest.raises(ExecutionError, match="no ROS master answers"):
        registration.require_master(1.0)
    assert registration.found_parameter("actionlib_status_frequency", 7.0, 1.0) == 7.0
    with pytest.raises(registration.MASTER_ERRORS):
        registration.published_topics(1.0)


@pytest.mark.timeout(60)
def test_an_order_of_the_page_says_it_too(master):
    watch = TeamWatch(read_plan("plans/patrol"), RosConnection(), "monday")
    watch.names = {"/robot_1": "robot_1"}
    with pytest.raises(RefusedError, match="the ROS master does not answer"):
        watch.command("stop", {})
    with pytest.raises(UnreachableError, match="the ROS master does not answer"):
        RosConnection().find()
