"""The page that watches a team, whose answers the test gives."""

import json
import threading
from collections import Counter
from types import SimpleNamespace

import pytest

from gspn_framework_package.execution.plan_change import digest_of
from gspn_framework_package.execution.team_state import StagedPlan
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.errors import GspnError, RefusedError
from gspn_framework_package.team.carrier import OperatorAnswer
from gspn_framework_package.team.deployed_plan import read_deployed
from gspn_framework_package.team.operator_client import UnreachableError
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.live_comparison import Departures
from gspn_framework_package.visualizer.team_watch import UNHEARD, TeamWatch

REFUSED = [{"robot": "robot_4", "why": "too large", "times": 3}]


class Silence:
    """A connection that sees nothing, and a line on which robots say what the test wants."""

    says, where = "a team", "on this master"

    def __init__(self, orders=True):
        self.orders, self.answers, self.asked, self.reported = orders, {}, [], []
        self.statuses = {}

    def open(self, seen):
        pass

    def close(self):
        pass

    def line(self, seconds):
        return self

    def call(self, address, robot, request, answered):
        if request.command == "status" and address in self.statuses:
            answered(OperatorAnswer(True, json.dumps(self.statuses[address])))
            return True
        self.asked.append((address, request.command, request.argument))
        if isinstance(self.answers.get(address), Exception):
            raise self.answers[address]
        answered(self.answers.get(address))
        return True

    def label(self, address):
        return address.strip("/")

    def why_unheard(self):
        return " anywhere"

    def report(self, text):
        self.reported.append(text)

    def report_departures(self, plan, run, found):
        self.reported.append(run)


class Watched:
    """The page of a team whose answers the test gives."""

    def __init__(self, monkeypatch, run="monday"):
        monkeypatch.setattr(threading.Thread, "start", lambda *_: None)
        self.plan = read_plan("plans/measure")
        self.connection = Silence()
        self.watch = TeamWatch(self.plan, self.connection, run)
        self.hub = Hub("", self.watch._follower.board({}))
        self.watch.begin(self.hub)
        self.length = 0

    def answer(
        self,
        place,
        run="monday",
        plan=None,
        ended=None,
        deployed=None,
        **more,
    ):
        """One robot of the team says where all are: in ``place``, or where that has each."""
        self.length += 1
        team = place if isinstance(place, dict) else dict.fromkeys(("robot_1", "robot_2"), place)
        status = self.status(team, run=run, **more)
        status.update(plan=plan or self.plan.hash(), ended=ended)
        heard = self.watch._read_answer("/robot_1", json.dumps(status))
        self.watch._on_answers(False, heard, deployed)

    def status(self, team, robot="robot_1", run="monday", **more):
        """What a robot says of the team (robot -> place)."""
        robots = [
            {"robot": name, "place": at, "state": "Doing", "visit": self.length, "waits_for": ""}
            for name, at in team.items()
        ]
        return {
            "robot": robot,
            "run": run,
            "plan": self.plan.hash(),
            "log_length": self.length,
            "robots": robots,
            "marking": Counter(team.values()),
            "paused": False,
            "ended": None,
            "finished": False,
            "fault": False,
            "synchronisation": "full",
            "active": True,
            "quorum": True,
            "waits_for": "",
            **more,
        }

    def notes(self):
        return [note["text"] for note in self.hub.board().notes]


def robots_shown(page):
    """Name -> place, as the board has them."""
    places = page.watch.plan.net.places
    return {name: places[robot["place"]].name for name, robot in page.hub.board().robots.items()}


@pytest.mark.parametrize(
    "team",
    [
        {"robot_1": "P1"},
        {"robot_1": "P4"},
        {"ada": "P1", "bob": "P5"},  # where the plan's robots begin
        {"ada": "P5", "robot_2": "P5", "cyd": "P1", "robot_9": "P4"},
    ],
)
def test_the_page_shows_the_team_that_it_hears(monkeypatch, team):
    """Not the robots of the plan."""
    page = Watched(monkeypatch)
    assert len(page.plan.robots) == 2 and robots_shown(page) == {}
    page.answer(team)
    assert robots_shown(page) == team
    marking = page.plan.net.named(page.hub.board().marking, zeros=False)
    assert marking == Counter(team.values())
    page.answer({**team, "late": "P1"})
    assert robots_shown(page) == {**team, "late": "P1"}


def test_a_robot_that_nobody_names_any_more_is_not_drawn(monkeypatch):
    page = Watched(monkeypatch)
    place = page.plan.robots[0].place
    page.answer(place)
    page.hub.publish({"k": "robots", "r": [{"name": "robot_9", "place": 0}], "gone": []})
    page.answer(place)
    assert set(robots_shown(page)) == {"robot_1", "robot_2"}


def test_a_run_is_predicted_for_the_team_that_is_heard(monkeypatch):
    page = Watched(monkeypatch)
    page.answer({"robot_1": "P1", "ada": "P4"})
    assert {robot.name for robot in page.watch._comparison._plan.robots} == {"robot_1", "ada"}


def test_a_prediction_names_the_run_that_was_chosen_later(monkeypatch):
    page = Watched(monkeypatch, run="")
    page.watch._show_run("tuesday")
    page.watch._comparison._listener(Departures([], [], []))
    assert page.connection.reported == ["tuesday"]


def test_the_page_warns_once_of_firings_that_it_does_not_hear(monkeypatch):
    page = Watched(monkeypatch)
    places = [
        place.name for place in page.plan.net.places if place.name not in page.plan.resource_places
    ]
    for number in range(UNHEARD):
        page.answer(places[number % 2])
        assert not page.notes()
    page.answer(places[UNHEARD % 2])
    page.answer(places[(UNHEARD + 1) % 2])
    (note,) = page.notes()
    assert "no firing is received anywhere: the page" in note


def test_the_page_warns_of_no_silence_while_the_team_stands(monkeypatch):
    page = Watched(monkeypatch)
    for _ in range(3 * UNHEARD):
        page.answer(page.plan.robots[0].place)
    assert not page.notes()


def test_the_page_takes_a_run_that_goes_on_before_one_that_is_over(monkeypatch):
    """Where it was not said which is to be shown."""
    page = Watched(monkeypatch, run="")
    place = page.plan.robots[0].place
    page.answer(place, run="strange", plan="of another plan")
    assert page.hub.board().status["run"] == ""
    said = {"robot": "robot_1", "run": "old", "plan": page.plan.hash()}
    page.watch._on_activity("/old", said)
    page.answer(place, run="new")
    assert page.hub.board().status["run"] == "new"
    assert sorted(note.split(" on ")[0] for note in page.notes()) == ["run 'old'", "run 'strange'"]


@pytest.mark.parametrize("trouble", [{"stuck": True}, {"astray": ["robot_2"]}])
def test_the_page_says_that_a_team_can_never_go_on_by_itself(monkeypatch, trouble):
    page = Watched(monkeypatch)
    place = page.plan.robots[0].place
    page.answer(place, waits_for="has no quorum: too many lost their logs", **trouble)
    assert page.hub.board().status["stalled"] == "robot_1 has no quorum: too many lost their logs"
    page.answer(place, stuck=False, astray=[])
    assert page.hub.board().status["stalled"] == ""


@pytest.mark.parametrize(
    "said", ["", "no JSON", "[" * 100_000, "[]", "3", "null", "{}", '{"run": "monday"}']
)
def test_an_answer_that_cannot_be_read_is_passed_over(monkeypatch, said):
    assert Watched(monkeypatch).watch._read_answer("/robot_1", said) == []


def test_a_failed_robot_is_shown_by_what_it_tells_itself(monkeypatch):
    """And no older answer of another takes that back or makes it up."""
    page = Watched(monkeypatch)

    def tell(state, needs_operator):
        said = {
            "robot": "robot_1",
            "run": "monday",
            "plan": page.plan.hash(),
            "state": state,
            "waits_for": "",
            "needs_operator": needs_operator,
            "ended": None,
            "visit": 1,
            "attempt": 1,
            "refused": REFUSED,
        }
        page.watch._on_activity("/robot_1", said)
        return next(
            robot["phase"]
            for robot in page.hub.board().to_json()["robots"]
            if robot["name"] == "robot_1"
        )

    assert tell("Waiting", True) == "failed"
    page.answer(page.plan.robots[0].place)
    assert tell("Waiting", True) == "failed"
    assert tell("Doing", False) == "doing"
    assert tell("Waiting", False) == "done"
    assert tell("Lost", True) == "lost"
    assert page.hub.board().robots["robot_1"]["refused"] == REFUSED


def test_the_page_notes_the_orders_that_come_after_it_heard_a_robot(monkeypatch):
    page = Watched(monkeypatch)
    page.answer(page.plan.robots[0].place)

    def tell(*walls):
        orders = [
            {
                "command": "pause",
                "robot": "",
                "argument": "",
                "operator": "ann",
                "proof": "certificate",
                "wall": wall,
            }
            for wall in walls
        ]
        page.watch._show_orders("robot_1", orders)
        return [note for note in page.notes() if "ann" in note]

    assert tell(1.0) == []  # before the page came
    assert tell(1.0, 2.0) == ["ann (certificate) orders: pause"]
    assert len(tell(1.0, 2.0, 3.0, 4.0)) == 3
    assert len(tell()) == 3


def deployed_to(plan):
    """A plan like ``plan`` in which P4 is called Alarm and the places come in reverse order, as a
    robot reports it."""
    data = json.loads(json.dumps(plan_to_json(plan)).replace('"P4"', '"Alarm"'))
    data["net"]["places"].reverse()
    staged = StagedPlan(1, digest_of(data), data, {"P4": "Alarm"})
    return read_deployed("monday", json.dumps(staged.to_json()))


def fired(plan, slot, transition, robot, place, marking):
    """The message of a firing that moved a robot."""
    return SimpleNamespace(
        plan=plan.hash(),
        run="monday",
        transition=transition,
        robot=robot,
        visit=2,
        robots=[robot],
        robot_places=[place],
        places=list(marking),
        counts=list(marking.values()),
        slot=slot,
        index=0,
        private_move=False,
        details="",
    )


def test_the_page_follows_a_team_to_another_plan(monkeypatch):
    page = Watched(monkeypatch)
    deployed, began = deployed_to(page.plan), page.plan.hash()
    new = deployed.plan
    page.answer("P1", began_with=began)
    before = page.hub.board().to_json()
    message = fired(new, 3, "T2", "robot_1", "Alarm", {"P1": 1, "Alarm": 1, "P3": 1})
    page.watch._on_fired(message)  # its plan is not known yet
    page.answer("P1", plan=new.hash(), began_with=began)  # and cannot be asked for
    assert page.hub.board().to_json() == before
    page.answer("P1", plan=new.hash(), began_with=began, deployed=deployed)
    board = page.hub.board()
    assert board.plan == 1 and page.watch.plan_of(1) is new
    assert new.net.named(board.marking, zeros=False) == {"P1": 1, "Alarm": 1, "P3": 1}
    places = {name: new.net.places[r["place"]].name for name, r in board.robots.items()}
    assert places["robot_1"] == "Alarm" and places["robot_2"] == "P1"
    page.watch._on_fired(fired(page.plan, 1, "T2", "robot_2", "P4", {"P4": 1}))  # comes late
    page.answer("P4", plan=began, began_with=began)  # of one who is behind
    assert new.net.named(page.hub.board().marking, zeros=False) == {"P1": 1, "Alarm": 1, "P3": 1}
    assert page.notes() == []


def test_a_page_that_is_opened_later_shows_the_run_under_its_present_plan(monkeypatch):
    page = Watched(monkeypatch, run="")
    deployed = deployed_to(page.plan)
    new = deployed.plan
    page.answer("Alarm", plan=new.hash(), began_with=page.plan.hash(), deployed=deployed)
    board = page.hub.board()
    assert board.status["run"] == "monday" and board.plan == 1
    assert new.net.named(board.marking, zeros=False) == {"Alarm": 2}


@pytest.mark.parametrize("said", ["", "{}", "[]", '{"number": 1}', '{"number": 1, "plan": 3}'])
def test_a_plan_that_cannot_be_read_is_none(said):
    assert read_deployed("monday", said) is None


def test_an_order_goes_to_the_robot_that_it_concerns_or_to_one_that_knows_most(monkeypatch):
    page = Watched(monkeypatch)
    page.watch.names = {"/r1": "robot_1", "/r2": "robot_2"}
    said = OperatorAnswer(True, "so be it")
    page.connection.answers = {"/r1": said, "/r2": said}
    page.connection.statuses = {
        "/r1": page.status({}, "robot_1"),
        "/r2": page.status({}, "robot_2", log_length=7),
    }
    orders = (("retry", "robot_1", "/r1"), ("pause", "", "/r2"), ("evict", "robot_2", "/r1"))
    for command, robot, at in orders:
        page.connection.asked.clear()
        assert page.watch.command(command, {"robot": robot}) == {"message": "so be it"}
        assert page.connection.asked == [(at, command, "")]
    del page.connection.statuses["/r1"]  # it does not answer
    assert page.watch.command("retry", {"robot": "robot_1"}) == {"message": "so be it"}
    page.connection.answers["/r2"] = OperatorAnswer(False, "no such task")
    with pytest.raises(RefusedError, match="no such task"):
        page.watch.command("retry", {"robot": "robot_1"})


def test_an_order_without_an_answer_is_not_given_to_another_robot(monkeypatch):
    """It might be carried out twice."""
    page = Watched(monkeypatch)
    page.watch.names = {"/r1": "robot_1", "/r2": "robot_2"}
    page.connection.statuses = {"/r%d" % i: page.status({}, "robot_%d" % i) for i in (1, 2)}
    with pytest.raises(RefusedError, match="robot_1 was given the order and has not answered"):
        page.watch.command("pause", {})
    assert page.connection.asked == [("/r1", "pause", "")]
    page.connection.statuses = {}
    with pytest.raises(RefusedError, match="no robot of run 'monday' answers"):
        page.watch.command("pause", {})
    page.connection.answers = {"/r1": UnreachableError("the wire is cut")}
    with pytest.raises(RefusedError, match="the wire is cut"):
        page.watch.command("pause", {})


def test_breakpoints_go_to_every_robot_and_who_does_not_take_them_is_named(monkeypatch):
    page = Watched(monkeypatch)
    page.watch.names = {"/r1": "robot_1", "/r2": "robot_2"}
    page.connection.answers = {name: OperatorAnswer(True, "") for name in ("/r1", "/r2")}
    place = page.plan.robots[0].place
    assert place in page.watch.command("breakpoints", {"names": [place]})["message"]
    page.connection.answers = {"/r1": OperatorAnswer(False, "too late")}
    with pytest.raises(RefusedError, match="^r1: too late; r2 does not answer$"):
        page.watch.command("breakpoints", {"names": [place]})


def test_a_page_whose_keys_give_no_orders_offers_none(monkeypatch):
    page = Watched(monkeypatch)
    assert "stop" in page.hub.info["commands"]
    watch = TeamWatch(page.plan, Silence(orders=False), "monday")
    watch.begin(page.hub)
    assert page.hub.info["commands"] == []
    for order in (lambda: watch.command("stop", {}), lambda: watch.deploy(page.plan, {}, print)):
        with pytest.raises(GspnError, match="cannot be done here|do not permit orders"):
            order()


def test_the_page_says_that_the_team_cannot_be_reached_until_it_can_be_again(monkeypatch):
    page = Watched(monkeypatch)
    page.answer(page.plan.robots[0].place)
    page.watch._on_unreachable("no router")
    status = page.hub.board().status
    assert (status["unreachable"], status["running"]) == ("no router", True)
    page.watch._on_unreachable("")
    assert page.hub.board().status["unreachable"] == ""
