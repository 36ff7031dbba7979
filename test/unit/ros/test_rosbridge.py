"""Our messages for programs that speak rosbridge: JSON holds every field without loss, and the
example in the documents uses what there is. (rosbridge itself is not among what Debian packages.)

rosbridge makes a JSON object of a message: a time is ``{"secs", "nsecs"}``, bytes (``uint8[]``,
``char[]``) become base64, and NaN and the infinities become null.
"""

import importlib
import json
import re
import shutil
import subprocess
from pathlib import Path

import genpy
import pytest
import yaml
from waiting import PATIENCE

from gspn_framework_package import msg, srv

ROOT = Path(__file__).parents[3]
ROS_JS = """
const told = [];
const ROSLIB = {
  Ros: class { constructor(options) { told.push({ url: options.url }); } },
  Topic: class {
    constructor({ ros, ...rest }) { this.rest = rest; }
    subscribe(callback) { told.push(this.rest); callback(MESSAGE); }
  },
  Service: class {
    constructor({ ros, ...rest }) { this.rest = rest; }
    callService(request, callback) { told.push({ ...this.rest, request }); callback(ANSWER); }
  },
};
"""


def messages():
    for path in sorted((ROOT / "msg").glob("*.msg")):
        yield getattr(msg, path.stem)
    for path in sorted((ROOT / "srv").glob("*.srv")):
        yield getattr(srv, path.stem + "Request")
        yield getattr(srv, path.stem + "Response")


def sample(kind, depth=0):
    """A message of this class, or a value of this type, in which nothing has its default."""
    if isinstance(kind, str):
        if kind.endswith("[]"):
            return [sample(kind[:-2], depth + 1), sample(kind[:-2], depth + 1)]
        plain = {"string": 'ä "x"\n', "bool": True, "float64": 0.1, "uint8": 7}
        if kind in plain:
            return plain[kind]
        if kind == "time":
            return genpy.Time(12, 34)
        if kind in ("int32", "uint32", "int64"):
            return 2**31 - 1
        package, name = kind.split("/")
        return sample(getattr(importlib.import_module(package + ".msg"), name), depth + 1)
    return kind(*(sample(each, depth) for each in kind._slot_types))


@pytest.mark.parametrize("kind", list(messages()), ids=lambda kind: kind.__name__)
def test_a_message_is_the_same_after_json(kind):
    assert not [t for t in kind._slot_types if re.match(r"(uint8|char)\[", t)]  # no base64
    whole = sample(kind)
    told = yaml.safe_load(str(whole)) or {}
    back = kind()
    genpy.message.fill_message_args(back, [json.loads(json.dumps(told, allow_nan=False))])
    assert back == whole


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_example_in_the_documents_watches_and_commands_a_robot():
    text = (ROOT / "docs" / "tools.md").read_text(encoding="utf-8")
    example = re.search(r":caption: watch\.js\n(.*?)```", text, re.DOTALL).group(1)
    message = json.dumps(yaml.safe_load(str(sample(msg.RobotActivity))))
    answer = json.dumps(yaml.safe_load(str(sample(srv.CommandResponse))))
    stage = ROS_JS.replace("MESSAGE", message).replace("ANSWER", answer)
    done = subprocess.run(
        ["node", "-e", stage + example + "\nconsole.error(JSON.stringify(told));"],
        capture_output=True,
        text=True,
        timeout=60 * PATIENCE,
    )
    assert done.returncode == 0 and "undefined" not in done.stdout, done.stderr
    _, topic, service = json.loads(done.stderr)
    source = (ROOT / "gspn_framework_package/ros/facts.py").read_text(encoding="utf-8")
    assert 'latched("%s", RobotActivity)' % topic["name"].rpartition("/")[2] in source
    assert topic["messageType"] == msg.RobotActivity._type
    assert service["serviceType"] == srv.Command._type
    assert service["name"].endswith("/command")
    request = srv.CommandRequest(**service["request"])
    assert request.command == "pause"
