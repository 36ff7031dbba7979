"""Subnets on the page: folded into one node with the robots inside, unfolded by mouse and keys."""

import copy
import itertools
import json
import math
import re

import pytest
from page_reading import dots, settle
from reported_run import ReportedRun

from gspn_framework_package.execution.log_entries import Done
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.visualizer.team_events import TeamEvents

DOCK = {
    "net": {
        "places": [{"name": "Approach"}, {"name": "Turn"}, {"name": "Docked"}],
        "transitions": [{"name": "near", "timed": True}, {"name": "turned", "timed": True}],
        "arcs": [
            {"from": "Approach", "to": "near"},
            {"from": "near", "to": "Turn"},
            {"from": "Turn", "to": "turned"},
            {"from": "turned", "to": "Docked"},
        ],
    },
    "actions": {"Approach": "a.b", "Turn": "a.b", "Docked": "a.b"},
}
HOME = {
    "net": {
        "places": [{"name": "Work", "tokens": 2}, {"name": "Dock"}],
        "transitions": [{"name": "go", "timed": True}, {"name": "leave", "timed": True}],
        "arcs": [
            {"from": "Work", "to": "go"},
            {"from": "go", "to": "Dock"},
            {"from": "Dock", "to": "leave"},
            {"from": "leave", "to": "Work"},
        ],
    },
    "actions": {
        "Work": "a.b",
        "Dock": {"plan": "dock.json", "entry": "Approach", "exit": "Docked"},
    },
    "robots": {"r1": "Dock", "r2": "Work"},
}


def test_a_subnet_folds_into_one_node(tmp_path, show_net, open_page, axe, picture):
    (tmp_path / "plan.json").write_text(json.dumps(HOME))
    (tmp_path / "dock.json").write_text(json.dumps(DOCK))
    plan = read_plan(str(tmp_path))
    run = ReportedRun(plan, {"run": "run_1"})
    game = TokenGame(plan)
    state = game.new_state()
    events = TeamEvents(game)
    events.board(True)

    def feed(*entries):
        step = game.reduce(state, state.next_slot, entries)
        run.hub.publish(*events.step(entries, step.firings, state))

    page = open_page(show_net(plan.net, plan, run).address)
    feed(game.start_entry())
    entry = page.locator(".place.subnet")
    page.wait_for_selector("#subnets button[aria-expanded='false']:has-text('Dock: 1 robot')")
    assert entry.count() == 1 and page.locator(".folded-away").count() == 4
    page.wait_for_selector(".place.subnet [data-robot='r1']")
    page.wait_for_selector(".place.subnet .label:has-text('Dock')")
    assert entry.locator(".label").text_content() == "Dock"
    # a step inside is no step of the folded net; a robot that comes in is
    feed(Done("r1", 0, 1, "Dock.near"), Done("r2", 0, 1, "go"))
    page.wait_for_selector("#subnets button:has-text('Dock: 2 robots')")
    page.wait_for_selector(".place.subnet [data-robot='r2']")
    page.wait_for_selector(".place.subnet [data-robot='r1']")
    picture(page, "subnet")

    page.focus("#subnets button")
    page.keyboard.press("Enter")
    page.wait_for_selector("#subnets button[aria-expanded='true']")
    assert page.locator(".folded-away").count() == entry.count() == 0
    turn = plan.net.place_number("Dock.Turn")
    page.wait_for_selector("[data-place='%d'] [data-robot='r1']" % turn)
    page.wait_for_selector(".label:has-text('Dock.Turn')")
    box = page.locator(".boxes rect").bounding_box()  # around it, and all of it in sight
    frame = page.locator("#net").bounding_box()
    assert frame["x"] <= box["x"] and box["x"] + box["width"] <= frame["x"] + frame["width"]
    page.keyboard.press("Enter")
    page.wait_for_selector(".place.subnet [data-robot='r1']")
    # who chooses a node inside gets to see it
    page.locator("#list li").filter(has_text=re.compile(r"Dock\.Turn\b")).first.click()
    page.wait_for_selector("[data-place='%d'].selected:not(.folded-away)" % turn)
    axe(page, "subnets", "right")


def spots(page):
    """Where nodes are drawn: name -> [x, y], in the units of the drawing."""
    return page.evaluate(
        "() => Object.fromEntries(window.gspn.page.view.nodes.map((n) => [n.name, [n.x, n.y]]))"
    )


DRAWN = {"Work": [100, 100], "Dock": [500, 160], "go": [300, 60], "leave": [300, 260]}
STAIRS = ["Approach", "near", "Turn", "turned", "Docked"]


@pytest.mark.parametrize("mode", ["SIMULATE", "LIVE"])
def test_every_mode_shows_what_was_drawn(
    tmp_path, mode, serve_folder, show_net, open_page, picture
):
    home, dock = copy.deepcopy(HOME), copy.deepcopy(DOCK)
    for place in home["net"]["places"]:
        place["tokens"] = 1
    for node in home["net"]["places"] + home["net"]["transitions"]:
        node["position"] = DRAWN[node["name"]]
    for node in dock["net"]["places"] + dock["net"]["transitions"]:
        node["position"] = [90 * STAIRS.index(node["name"]), -50 * STAIRS.index(node["name"])]
    (tmp_path / "plan.json").write_text(json.dumps(home))
    (tmp_path / "dock.json").write_text(json.dumps(dock))
    if mode == "SIMULATE":
        page = open_page(serve_folder(tmp_path).address + "#file-plan.json")
    else:
        plan = read_plan(str(tmp_path))
        page = open_page(show_net(plan.net, plan, ReportedRun(plan, {"run": "run_1"})).address)
    page.wait_for_selector("body[data-mode='%s']" % mode)
    settle(page)
    folded = spots(page)
    scale = (folded["go"][0] - folded["Work"][0]) / (DRAWN["go"][0] - DRAWN["Work"][0])
    for name, (x, y) in DRAWN.items():
        now = folded["Dock.Approach" if name == "Dock" else name]
        assert abs(now[0] - folded["Work"][0] - (x - 100) * scale) < 1, name
        assert abs(now[1] - folded["Work"][1] - (y - 100) * scale) < 1, name
    picture(page, "subnet-drawn-" + mode.lower())
    # the button says as many as the node shows
    shown = dots(page)[page.evaluate("() => window.gspn.page.view.subnets.all[0].entry")]
    assert page.text_content("#subnets button") == "Dock: 1 robot" and shown == 1

    page.click("#subnets button")
    page.wait_for_selector("#subnets button[aria-expanded='true']")
    page.click("#fit")
    settle(page)
    inner = [spots(page)["Dock." + name] for name in STAIRS]
    for i, step in enumerate(inner):  # as its own plan draws it
        assert step == pytest.approx(
            [a + (b - a) * i / 4 for a, b in zip(inner[0], inner[4])], 0.01
        )
    picture(page, "subnet-unfolded-" + mode.lower())
    pairs = itertools.combinations(spots(page).values(), 2)
    assert min(math.dist(a, b) for a, b in pairs) > 40  # the diameter of a place
    page.click("#subnets button")
    page.wait_for_selector("#subnets button[aria-expanded='false']")
    assert spots(page) == folded
