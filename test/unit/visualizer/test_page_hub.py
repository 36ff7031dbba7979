"""The hub: every viewer gets every event once and in order, or a whole snapshot; nothing grows."""

import json
import threading

from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.visualizer.board import Board
from gspn_framework_package.visualizer.hub import NEWS, Cursor, Hub


def fire(p=0, change=1):
    return {"k": "fire", "tr": 0, "who": "", "d": [[p, change]], "m": [], "en": [], "dis": []}


def new_hub(ring=100):
    hub = Hub("", Board(1, [0, 0]), ring)
    hub.restart("SIMULATE", Board(1, [0, 0]))
    return hub


def read(hub, cursor=None):
    news = hub.news(cursor)
    return json.loads(news.text), news.cursor


def test_a_new_viewer_gets_the_state_at_once():
    hub = new_hub()
    hub.publish(fire(), fire(1))
    news, _ = read(hub)
    assert news["snapshot"]["board"]["marking"] == [1, 1]
    assert news["snapshot"]["board"]["counts"] == [2]


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 30), max_size=12), st.integers(5, 40))
def test_a_viewer_reads_all_events_once_or_a_snapshot(bursts, ring):
    hub = new_hub(ring)
    _, cursor = read(hub)
    seen, marking = 0, [0, 0]
    for burst in bursts:
        for i in range(burst):
            hub.publish(fire(i % 2))
        news, cursor = read(hub, cursor)
        if "snapshot" in news:
            assert burst > ring  # only where events were lost
            seen, marking = news["snapshot"]["board"]["n"], news["snapshot"]["board"]["marking"]
        for event in news.get("events", ()):
            assert event["n"] == seen + 1
            seen += 1
            for p, change in event["d"]:
                marking[p] += change
        assert marking == hub.board().marking


def test_a_viewer_far_behind_catches_up_message_by_message():
    hub = new_hub(ring=5000)
    _, cursor = read(hub)
    hub.publish(*(fire() for _ in range(2 * NEWS + 5)))
    sizes, seen = [], 0
    while hub.wait(cursor, 0):
        news, cursor = read(hub, cursor)
        assert [e["n"] for e in news["events"]] == list(
            range(seen + 1, seen + 1 + len(news["events"]))
        )
        seen += len(news["events"])
        sizes.append((len(news["events"]), news.get("more", False)))
        assert news["cursor"] == str(cursor)
    assert sizes == [(NEWS, True), (NEWS, True), (5, False)]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1300), st.integers(0, 1300))
def test_any_moment_in_the_ring_is_found(total, at):
    hub = new_hub(700)
    for i in range(total):
        hub.publish(fire(i % 2))
    n = max(total - 700, min(at, total))
    board = hub.board_at(at)
    assert board.n == n
    assert board.marking == [(n + 1) // 2, n // 2]


def test_another_epoch_gives_a_snapshot():
    hub = new_hub()
    hub.publish(fire())
    _, cursor = read(hub)
    hub.restart("LIVE", Board(1, [5, 5]))
    hub.publish(fire())
    news, _ = read(hub, cursor)
    assert news["snapshot"]["mode"] == "LIVE"
    assert news["snapshot"]["board"]["marking"] == [6, 5]


def test_a_cursor_from_the_future_gives_a_snapshot():
    hub = new_hub()
    news, _ = read(hub, Cursor(hub.epoch, 99))
    assert "snapshot" in news


def test_cursors_that_make_no_sense_are_none():
    for text in (None, "", "x", "a:b", "a:1:2:3", "a:-1", "a:" + "9" * 30):
        assert Cursor.parse(text) is None
    assert Cursor.parse("ab:3:4") == Cursor("ab", 3, 4)


def test_nothing_grows_with_the_events():
    hub = new_hub(1000)
    for i in range(5000):
        hub.publish(fire(0, 1 if i % 2 else -1))
    assert len(hub._events) == len(hub._texts) == 1000
    assert len(hub._keyframes) <= 1000 // 500 + 2


def test_waiting_wakes_up_for_events_and_latest_values():
    hub = new_hub()
    _, cursor = read(hub)
    assert not hub.wait(cursor, 0.01)
    for wake in (lambda: hub.publish(fire()), lambda: hub.set_latest("room", {"x": 1})):
        woken = []
        waiter = threading.Thread(target=lambda c=cursor, w=woken: w.append(hub.wait(c, 20)))
        waiter.start()
        wake()
        waiter.join(20)
        assert woken == [True]
        news, cursor = read(hub, cursor)
    assert news["latest"] == {"room": {"x": 1}} and news["events"] == []
    assert read(hub, cursor)[0]["latest"] == {}


def test_past_events_are_those_in_the_ring():
    hub = new_hub(10)
    for _ in range(25):
        hub.publish(fire())
    assert [e["n"] for e in hub.events(0, 10**9)] == list(range(16, 26))
    assert [e["n"] for e in hub.events(20, 22)] == [21, 22]
    assert [e["n"] for e in hub.events(0, 10**9, limit=3)] == [23, 24, 25]
