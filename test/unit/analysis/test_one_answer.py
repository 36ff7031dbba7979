"""All that answers for a plan says the same. The campaign is ``test/campaigns/one_answer.py``."""

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from one_answer import answers, plans

from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.team.verdict import verdict
from gspn_framework_package.testing import Scenario


@pytest.mark.long
@settings(
    max_examples=50,
    deadline=None,
    derandomize=True,
    phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@given(plan=plans())
def test_all_say_the_same(plan, tmp_path_factory):
    answers(plan, tmp_path_factory.getbasetemp() / "one_answer")


FUNCTIONS = """
def nothing():
    pass


def some(speed: float = 1.0, label="slow", on=True):
    pass


def needed(speed: float, count: int, data=None):
    pass


def any_of(**settings):
    pass


class Kind:
    def __init__(self, count: int, names=()):
        pass

    def __call__(self, data):
        pass


class Plain:
    pass


class Asking:
    def __call__(self, speed):
        pass
"""
SETTINGS = st.dictionaries(
    st.sampled_from(["speed", "label", "on", "count", "names", "data"]),
    st.sampled_from([1, 0.5, "0.5", True, None, [], {"x": 1}]),
    max_size=3,
)


@pytest.mark.long
@settings(max_examples=100, deadline=None, derandomize=True, phases=[Phase.generate])
@given(
    name=st.sampled_from(
        ["nothing", "some", "needed", "any_of", "Kind", "Plain", "Asking", "missing"]
    ),
    given_settings=SETTINGS,
)
def test_settings_that_the_check_lets_pass_can_be_passed(name, given_settings, functions_folder):
    net = NetBuilder("one").place("a", tokens=1).exponential("t", inputs="a", outputs="a").build()
    plan = Plan(
        net,
        actions={"a": FunctionAction("one_answer_functions." + name, name, given_settings)},
        robots=(RobotSpec("r", "a"),),
        folder=str(functions_folder),
    )
    try:
        Scenario(plan, functions=True)
        loads = True
    except GspnError:
        loads = False
    assert verdict(plan).refused is not loads


@pytest.fixture(scope="module")
def functions_folder(tmp_path_factory):
    """A folder of a plan with functions that take settings."""
    folder = tmp_path_factory.mktemp("functions")
    (folder / "one_answer_functions.py").write_text(FUNCTIONS)
    return folder
