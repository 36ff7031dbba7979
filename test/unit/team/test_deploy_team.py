"""An operator's deployment: what the team is ordered, and each refusal in a sentence."""

import json

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.plan_change import stage_of
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.team import deploy_team
from gspn_framework_package.team.deploy_team import deploy_to_team

PLAN = "plans/measure/plan.json"
ENTRY = stage_of(read_plan(PLAN), {"P4": "Alarm"}, "/plans")
BROKEN = "measure: there is no function 'actions.measure'"


class Told:
    """A team whose votes the test gives, one after the other."""

    def __init__(self, *votes, refuses=(), digest=ENTRY.digest, adopted=0):
        self.votes, self.refuses, self.digest = list(votes), dict(refuses), digest
        self.adopted = adopted
        self.ordered, self.heard = [], []

    def order(self, command, text):
        self.ordered.append((command, text))
        return command not in self.refuses, self.refuses.get(command, "%s: taken" % command)

    def statuses(self):
        votes = self.votes.pop(0) if len(self.votes) > 1 else self.votes[0]
        staged = votes and {"stage": 3, "plan": "m", "digest": self.digest, "votes": votes}
        behind = {"run": "monday", "log_length": 4, "staged": None}
        newest = {"run": "monday", "log_length": 7, "staged": staged, "adopted": self.adopted}
        return [behind, newest]

    def deploy(self, **options):
        outcome = deploy_to_team(
            self.order, self.statuses, ENTRY, tell=self.heard.append, wait=0.3, **options
        )
        return outcome, [command for command, _ in self.ordered]


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(deploy_team, "POLL", 0.001)


def test_a_plan_that_all_can_follow_is_adopted():
    team = Told({"a": None, "b": None}, {"a": "", "b": None}, {"a": "", "b": ""})
    outcome, commands = team.deploy()
    assert outcome.done and outcome.message == "adopt: taken" and commands == ["stage", "adopt"]
    assert team.ordered[1] == ("adopt", "3") and team.heard == [
        {"a": None, "b": None},
        {"a": "", "b": None},
        {"a": "", "b": ""},
    ]
    sent = json.loads(team.ordered[0][1])
    assert sent == {"plan": ENTRY.plan, "map": {"P4": "Alarm"}, "folder": "/plans"}


def test_a_plan_is_left_staged_if_that_is_wanted():
    outcome, commands = Told({"a": ""}).deploy(stage_only=True)
    assert outcome.done and outcome.stage == 3 and commands == ["stage"]


@pytest.mark.parametrize(
    "team, says",
    [
        (Told({"a": None, "b": BROKEN}), "b cannot follow the plan: " + BROKEN),
        (Told({"a": "", "b": None}), "no vote within 0.3 s from: b"),
        (Told(None), "no vote within 0.3 s from: anybody"),
        (Told({"a": None}, None), "another plan was staged, or this one was unstaged"),
        (
            Told({"a": ""}, refuses={"adopt": "a is in 'P4', which the new plan does not have"}),
            "a is in 'P4', which the new plan does not have",
        ),
    ],
)
def test_a_refusal_is_a_sentence_and_the_stage_is_given_up(team, says):
    outcome, commands = team.deploy()
    assert not outcome.done and outcome.message == says
    assert commands[-1] == ("unstage" if outcome.stage else "stage")
    assert team.ordered[-1] in (("unstage", "3"), team.ordered[0])


def test_a_plan_that_was_adopted_by_an_order_without_an_answer_in_time_is_adopted():
    # the next robot was asked, and by then no plan was staged
    team = Told({"a": ""}, refuses={"adopt": "no plan is staged"}, adopted=3)
    outcome, commands = team.deploy()
    assert outcome.done and outcome.message == deploy_team.ADOPTED
    assert outcome.stage == 3 and commands == ["stage", "adopt"]


def test_an_order_that_no_robot_takes_ends_it():
    team = Told({"a": ""}, refuses={"stage": "has no quorum"})
    outcome, commands = team.deploy()
    assert (outcome.done, outcome.message, commands) == (False, "has no quorum", ["stage"])


@pytest.mark.parametrize("why, code", [("", 0), (BROKEN, 1)])
def test_gspn_deploy_answers_a_script(monkeypatch, capsys, why, code):
    team = Told({"robot_1": why}, digest=stage_of(read_plan(PLAN), {}).digest)

    class Client:
        def order(self, command, robot, text, run):
            return team.order(command, text)

        def statuses(self):
            return dict(enumerate([None, *team.statuses()]))

    monkeypatch.setattr("gspn_framework_package.cli.deploy.team_client", lambda args: Client())
    assert main(["deploy", PLAN, "--json"]) == code
    assert json.loads(capsys.readouterr().out) == {
        "order": "deploy",
        "done": not why,
        "message": "robot_1 cannot follow the plan: " + why if why else "adopt: taken",
        "stage": 3,
        "votes": {"robot_1": why},
    }
