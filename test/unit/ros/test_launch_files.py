"""Every parameter of the execution node is an argument of each launch file that starts one."""

import pytest

pytest.importorskip("roslaunch")

from pathlib import Path

from roslaunch.arg_dump import get_args
from roslaunch.config import load_config_default

from gspn_framework_package.ros.options import NodeOptions

LAUNCH = Path(__file__).resolve().parents[3] / "launch"
NODES = ("gspn_executor", "gspn_team", "gspn_hosted")
OF_ONE_ROBOT = {"robot", "number", "place"}
OF_A_TEAM = {"prefix", "place_server_nodes", "respawn"}
FILES = {
    ("robot", ""): OF_A_TEAM,
    ("team", ""): OF_ONE_ROBOT,
    ("team", "fork:=false"): OF_ONE_ROBOT | OF_A_TEAM,
    ("hosted", ""): OF_ONE_ROBOT | (OF_A_TEAM - {"prefix"}),
    ("patrol", "simulate:=false"): OF_ONE_ROBOT | {"plan", "room_plan"},
    ("warehouse", "simulate:=false"): OF_ONE_ROBOT | {"plan", "room_plan"},
}
"""(launch file, argument) -> options that its nodes do not have, or that the file decides."""


def another(option):
    """A value that is not the default of an option."""
    default = NodeOptions._field_defaults[option]
    if isinstance(default, bool):
        return not default
    return "other_" + option if isinstance(default, str) else default + 2


@pytest.mark.parametrize("file, word", FILES)
def test_every_option_of_the_node_can_be_given(file, word):
    path = str(LAUNCH / (file + ".launch"))
    wanted = {n: another(n) for n in NodeOptions._fields if n not in FILES[file, word]}
    given = {n: v for n, v in wanted.items() if n != "place_server_nodes"}
    given["place_servers"] = "none" if file == "hosted" else "node"  # decides about both
    words = ["%s:=%s" % pair for pair in given.items()]
    config = load_config_default([(path, [*words, word])], None, verbose=False)
    nodes = [node for node in config.nodes if node.type in NODES]
    assert nodes
    for node in nodes:
        start = node.namespace + node.name + "/"
        found = {k[len(start) :]: p.value for k, p in config.params.items() if k.startswith(start)}
        assert found.items() >= wanted.items()
        assert found.keys() <= set(NodeOptions._fields)
    assert set(given) <= set(get_args([path])), "what is not declared, --ros-args does not tell"


@pytest.mark.parametrize("file", ["robot", "team", "hosted", "patrol", "warehouse"])
def test_what_is_not_given_is_as_the_node_has_it(file):
    arguments = get_args([str(LAUNCH / (file + ".launch"))])
    for name, default in NodeOptions._field_defaults.items():
        if name in arguments and isinstance(default, float):
            assert float(arguments[name][1]) == default, name
        elif name == "max_connections":
            assert int(arguments[name][1]) == default
