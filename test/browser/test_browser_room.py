"""The room beside the net, in a browser: robots at their poses, and what is selected on either side."""

import pytest

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.visualizer.board import Board, first_status
from gspn_framework_package.visualizer.poses import PoseTrack

MAP = {
    "bounds": [[0.0, 0.0], [10.0, 5.0]],
    "grid": {"width": 4, "height": 2, "runs": [2, 4, 1, 4]},  # a wall along the bottom
}


@pytest.fixture(name="shown")
def _shown(show_net, open_page):
    """A page that shows two robots of a live team; its hub."""
    net = (
        NetBuilder("rooms")
        .place("Wait_L1", tokens=1)
        .place("Check_L2", tokens=1)
        .exponential("go", inputs="Wait_L1", outputs="Check_L2")
        .build()
    )
    site = show_net(net)
    hub = site.session().hub
    hub.restart("LIVE", Board(1, (1, 1), [0], first_status("run", True)))
    robots = [
        {"name": "r1", "place": 0, "phase": "doing"},
        {"name": "r2", "place": 1, "phase": "doing"},
    ]
    hub.publish({"k": "robots", "r": robots, "gone": []})
    page = open_page(site.address + "#net")
    return page, hub


def _poses(**poses):
    return {"robots": {name: {"pose": list(pose), "by": by} for name, (*pose, by) in poses.items()}}


def _settled(page, name, x, y):
    page.wait_for_function(
        "([name, x, y]) => { const pose = gspn.page.room.drawn.get(name); "
        "return pose && Math.hypot(pose[0] - x, pose[1] - y) < 0.01; }",
        arg=[name, x, y],
    )


def _click(page, x, y):
    left, top = page.evaluate("(at) => gspn.page.room.at(at)", [x, y])
    page.click("#room canvas", position={"x": left, "y": top})


def _colour(page, x, y):
    return page.evaluate(
        "(at) => { const { canvas, at: place } = gspn.page.room; const [x, y] = place(at); "
        "const k = canvas.width / canvas.clientWidth; "
        "return [...canvas.getContext('2d').getImageData(x * k, y * k, 1, 1).data].slice(0, 3); }",
        [x, y],
    )


def test_the_room_and_the_net_select_in_each_other(shown, axe):
    page, hub = shown
    assert page.locator("#room").is_hidden()
    hub.set_latest("room", MAP)
    hub.set_latest(
        "world", _poses(r1=(2.0, 4.0, 0.0, "amcl_pose"), r2=(8.0, 4.0, 1.0, "amcl_pose"))
    )
    page.wait_for_selector("#room:not([hidden])")
    _settled(page, "r2", 8.0, 4.0)
    wall, free = _colour(page, 5.0, 1.0), _colour(page, 5.0, 4.0)
    assert wall != free
    _click(page, 8.0, 4.0)
    page.wait_for_selector("#list li[aria-selected='true']:has-text('Check_L2')")
    assert "r1 in Wait_L1, r2 in Check_L2" in page.get_attribute("#room canvas", "aria-label")
    assert page.evaluate("() => gspn.page.room.selection") == 1
    page.click("#list li:has-text('Wait_L1')")
    page.wait_for_function("() => gspn.page.room.selection === 0")
    axe(page, "room", "right")


def test_a_location_of_a_world_selects_its_place(shown):
    page, hub = shown
    area = {"L1": {"area": [[1, 1], [3, 2]]}, "L2": {"area": [[6, 1], [8, 2]]}}
    hub.set_latest("room", {"bounds": [[0, 0], [10, 5]], "locations": area})
    page.wait_for_selector("#room:not([hidden])")
    _click(page, 7.0, 1.2)
    page.wait_for_selector("#list li[aria-selected='true']:has-text('Check_L2')")


def test_robots_glide_to_where_they_are_and_go_with_their_reports(shown):
    page, hub = shown
    hub.set_latest("world", _poses(r1=(0.0, 0.0, 0.0, "odom"), r2=(9.0, 3.0, 0.0, "amcl_pose")))
    page.wait_for_selector(".room-note:has-text('By odometry, each from its own start: r1.')")
    hub.set_latest("world", _poses(r1=(5.0, 1.0, 3.0, "amcl_pose")))
    _settled(page, "r1", 5.0, 1.0)
    page.wait_for_function("() => gspn.page.room.drawn.size === 1")


def test_the_time_line_moves_the_robots_in_the_room_too(show_net, open_page):
    """Two robots of a recorded run, of which one goes on."""
    track = PoseTrack()
    track.room = MAP
    for i in range(200):
        track.add(
            i / 2, _poses(r1=(i / 20, 1.0, 0.0, "odom"), r2=(8.0, 4.0, 0.0, "odom"))["robots"]
        )
    net = NetBuilder("rooms").place("A", tokens=2).place("B")
    site = show_net(net.exponential("go", inputs="A", outputs="B").build())
    hub = site.session().hub
    hub.restart("REPLAY", Board(2, (2, 0), [0], first_status("run", False)), track=track)
    robots = [{"name": name, "place": 0, "phase": "doing"} for name in ("r1", "r2")]
    hub.publish({"k": "robots", "r": robots, "gone": [], "t": 0.0})
    moved = [{"name": "r1", "place": 1, "phase": "doing"}]
    hub.publish({"k": "robots", "r": moved, "gone": [], "t": 80.0})
    page = open_page(site.address + "#net")
    page.wait_for_selector("#room:not([hidden])")
    page.evaluate("() => gspn.model.showTime(80)")
    _settled(page, "r1", 8.0, 1.0)
    page.evaluate("() => gspn.model.showTime(0)")
    _settled(page, "r1", 0.0, 1.0)
    _click(page, 0.0, 1.0)
    page.wait_for_selector("#list li[aria-selected='true']:has-text('A')")
    page.evaluate("() => { gspn.model.speed = 20; gspn.model.play(); }")
    page.wait_for_function(
        "() => { const [x] = gspn.page.room.drawn.get('r1'); return x > 1 && x < 7; }"
    )
    _settled(page, "r1", 8.0, 1.0)


def test_robots_in_the_past_of_a_live_run_are_where_they_were(shown):
    page, hub = shown
    hub.show_world(_poses(r1=(1.0, 1.0, 0.0, "odom")))
    _settled(page, "r1", 1.0, 1.0)
    hub.publish({"k": "note", "level": "info", "text": "a moment", "robot": ""})
    page.wait_for_function("() => gspn.model.board.n === 2")
    page.keyboard.press(" ")
    page.wait_for_function("() => !gspn.model.following")
    # what lies between two reports is drawn: the second one is to come after the stretch is loaded
    page.wait_for_function("() => gspn.page.room.past.known && !gspn.page.room.past.loading")
    hub.show_world(_poses(r1=(7.0, 1.0, 0.0, "odom")))
    page.wait_for_function("() => gspn.model.latest.world.robots.r1.pose[0] === 7")
    _settled(page, "r1", 1.0, 1.0)
    page.evaluate("() => gspn.model.backToLive()")
    _settled(page, "r1", 7.0, 1.0)
