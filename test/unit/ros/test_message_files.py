"""The comments of the message files, and the documents, say what the program does."""

import re
from pathlib import Path

import pytest

pytest.importorskip("gspn_framework_package.msg")

from gspn_framework_package.ros.facts import RosFacts
from gspn_framework_package.srv import GetState
from gspn_framework_package.team.status_reporter import ACTIVITY_PERIOD, TEAM_PERIOD

ROOT = Path(__file__).resolve().parents[3]
TIMES = {0.1: "ten", 0.2: "five"}
TOLD = {"RobotActivity": ACTIVITY_PERIOD, "Marking": TEAM_PERIOD, "TeamState": TEAM_PERIOD}


def rates(text):
    """How often something is published, in words, as a text says it."""
    return re.findall(r"at most (\w+) (?:times )?(?:a\s+second)", re.sub(r"\s*\n[#\s]*", " ", text))


@pytest.mark.parametrize("message", TOLD)
def test_a_message_is_published_as_often_as_its_file_and_the_documents_say(message):
    wanted = [TIMES[TOLD[message]]]
    assert rates((ROOT / "msg" / (message + ".msg")).read_text()) == wanted
    page = (ROOT / "docs" / "ros_interface.md").read_text()
    (row,) = (r for r in page.splitlines() if re.match(r"\| `\w+.*`gspn_\w+/%s`" % message, r))
    assert rates(row) == wanted
    docstring = RosFacts.__doc__ or ""
    (item,) = (i for i in re.split(r"\n *- ", docstring) if message in i)
    assert rates(item) == wanted


def test_a_message_file_names_fields_that_there_are():
    files = [*ROOT.glob("msg/*.msg"), *ROOT.glob("srv/*.srv")]
    text = re.sub(r"\s*\n#?\s*", " ", "\n".join(file.read_text() for file in files))
    named = re.findall(r"field (\w+) of GetState", text) + re.findall(r"GetState\.(\w+)", text)
    assert named and set(named) <= set(GetState._response_class.__slots__)
