"""What an operator orders of a running team on the page, and what a viewer may not."""

import pytest
from page_reading import boxes
from reported_run import ReportedRun

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.plan import Plan, RobotSpec

COMMANDS = ["evict", "fire", "leave", "pause", "resume", "retry", "set_place", "stop"]


class Team(ReportedRun):
    """Two robots of run "run_7"; keeps the orders, and refuses those for robot_2."""

    def __init__(self, plan):
        status = {"paused": False, "ended": None, "run": "run_7"}
        super().__init__(plan, status, environment=["rain"], commands=COMMANDS)
        self.given = []
        self.commands = {name: self._taker(name) for name in COMMANDS}

    def _taker(self, name):
        def take(fields):
            self.given.append({"command": name, **fields})
            if fields.get("robot") == "robot_2":
                raise RefusedError("robot_2 does not listen")
            return {"message": "done in the log"}

        return take

    def robot(self, name, **fields):
        self.hub.publish({"k": "robots", "r": [{"name": name, **fields}], "gone": []})


@pytest.fixture(name="team")
def _team(show_net):
    net = NetBuilder("garden").place("here", 2).place("there").place("sky", 1).place("wet")
    net.immediate("go", inputs="here", outputs="there").exponential(
        "rain", inputs="sky", outputs="wet"
    )
    robots = (RobotSpec("robot_1", "here"), RobotSpec("robot_2", "here"))
    plan = Plan(net.build(), "garden", resource_places=frozenset({"sky", "wet"}), robots=robots)
    team = Team(plan)
    team.site = show_net(plan.net, plan, team)
    return team


def order(page, robot, label):
    page.click(".robot-card[data-robot='%s'] button:has-text('%s')" % (robot, label))


def test_every_order_names_its_run_and_its_answer_is_shown(team, open_page, picture):
    page = open_page(team.site.address, expect_errors=True)  # a refusal is logged by the browser
    page.click("#stop")
    page.wait_for_selector("dialog[open] h2:has-text('run_7')")
    page.click("dialog button:has-text('Cancel')")
    page.wait_for_selector("dialog:not([open])", state="attached")
    assert team.given == []

    page.click("#pause-team")
    page.wait_for_selector("#robots .orders li:has-text('done in the log')")
    team.hub.publish({"k": "status", "status": {"paused": True}})
    page.click("#pause-team:has-text('Resume the team')")
    team.hub.publish({"k": "status", "status": {"paused": False}})

    page.click("#stop-actions")
    page.wait_for_selector("#robots .orders li:has-text('Stop all actions')")

    order(page, "robot_1", "Pause")
    team.robot("robot_1", paused=True)
    order(page, "robot_1", "Stop")
    page.wait_for_selector("#robots .orders li:has-text('Stop robot_1')")
    order(page, "robot_1", "Resume")
    team.robot("robot_1", paused=False, phase="failed", why="its gripper is stuck")
    order(page, "robot_1", "Try again")
    team.robot("robot_1", phase="doing", why="")
    # the button that was pressed has gone, and the panel goes on
    page.wait_for_selector(".robot-card.is-doing[data-robot='robot_1'] .badge:has-text('acts')")
    assert (
        page.locator(".robot-card[data-robot='robot_1'] button:has-text('Try again')").count() == 0
    )

    order(page, "robot_1", "More")
    page.wait_for_selector("dialog[open] h2:has-text('robot_1')")
    picture(page, "orders_for_a_robot")
    page.select_option("dialog select", "there")
    page.click("dialog button:has-text('Set place')")
    order(page, "robot_1", "More")
    page.click("dialog button:has-text('Leave the team')")
    order(page, "robot_2", "More")
    page.click("dialog button:has-text('Evict')")
    # a robot that acts is not evicted by one click
    page.wait_for_selector("dialog[open] h2:has-text('Evict robot_2 from the run')")
    assert not any(given["command"] == "evict" for given in team.given)
    page.click("dialog button:has-text('Cancel')")
    page.wait_for_selector("dialog:not([open])", state="attached")
    order(page, "robot_2", "More")
    page.click("dialog button:has-text('Evict')")
    page.click("dialog button:has-text('Evict robot_2')")
    page.wait_for_selector("#robots .orders li.refused:has-text('robot_2 does not listen')")
    picture(page, "orders")

    page.click("#list li[data-key='t1']")
    # news that come while the button is down take it away from nobody
    page.wait_for_selector("#inspector button:has-text('Fire'):enabled")
    x0, y0, x1, y1 = boxes(page, "#inspector [data-order='fire']")[0]
    page.mouse.move((x0 + x1) / 2, (y0 + y1) / 2)
    page.mouse.down()
    page.evaluate(
        "() => { for (const part of ['inspector', 'robots']) window.gspn.page[part].refresh?.(); }"
    )
    page.mouse.up()
    page.wait_for_selector("#toast:has-text('Fire rain')")
    page.click("#stop")
    page.fill("dialog input", "smoke")
    page.keyboard.press("Enter")
    page.wait_for_selector("#toast:has-text('Stop run_7: done in the log')")
    one = {"robot": "robot_1", "run": "run_7"}
    assert team.given == [
        {"command": "pause", "run": "run_7"},
        {"command": "resume", "run": "run_7"},
        {"command": "pause", "stop": True, "run": "run_7"},
        {"command": "pause", **one},
        {"command": "pause", "stop": True, **one},
        {"command": "resume", **one},
        {"command": "retry", **one},
        {"command": "set_place", "place": "there", **one},
        {"command": "leave", **one},
        {"command": "evict", "robot": "robot_2", "run": "run_7"},
        {"command": "fire", "transition": "rain", "run": "run_7"},
        {"command": "stop", "reason": "smoke", "run": "run_7"},
    ]
    # what broke is distinguished from what was stopped; after the end nobody acts
    team.hub.publish(
        {"k": "status", "status": {"running": False, "ended": "the disk is full", "fault": True}}
    )
    page.wait_for_selector(".alarm:has-text('Failed: the disk is full')")
    page.keyboard.press("2")
    page.wait_for_selector(".robot-card[data-robot='robot_1'] .badge:has-text('stopped')")
    assert (
        page.is_hidden("#stop")
        and page.is_hidden("#pause-team")
        and page.locator(".robot-card button").count() == 0
    )


def test_who_may_only_look_is_reported_why_nothing_can_be_pressed(team, show_net, open_page):
    site = show_net(
        team.plan.net, team.plan, Team(team.plan), viewer_token="only-for-looking-at-it"
    )
    page = open_page(site.server.invitations["viewer"])
    page.wait_for_selector("#robots:has-text('is read-only')")
    for button in ("#stop", "#pause-team", ".robot-card[data-robot='robot_1'] button >> nth=0"):
        assert page.is_disabled(button) and "is read-only" in page.get_attribute(button, "title")
    page.keyboard.press("3")
    page.click("#an-all")
    page.wait_for_selector("#toast:has-text('is read-only')")
