"""What comes in from the network is checked before anybody works on it."""

import json

from hypothesis import given
from hypothesis import strategies as st

from gspn_framework_package.team.message_filter import (
    COUNTS_ONCE,
    FASTEST,
    MessageFilter,
    NotTaken,
    json_object,
)


def test_a_flood_is_not_heard_until_it_ends_and_hurts_no_other_robot():
    messages = MessageFilter(1000)
    let_in = sum(messages.admits("flooder", 100, i / 100_000) for i in range(300_000))
    assert let_in <= 1.1 * FASTEST  # the first burst, and nothing while it goes on
    assert all(messages.admits("other", 100, 3.0) for _ in range(1000))
    assert [r.robot for r in messages.refusals()] == ["flooder"]
    assert messages.refusals()[0].times == 300_000 - let_in
    assert messages.admits("flooder", 100, 3.0 + 1.01 * 1.0)


def test_a_burst_that_is_used_up_comes_back_at_the_rate_of_the_limit():
    messages = MessageFilter(1000)
    assert all(messages.admits("r", 1, 0.0) for _ in range(int(FASTEST)))
    assert sum(messages.admits("r", 1, 0.01) for _ in range(100)) == FASTEST * 0.01


def test_who_floods_is_heard_again_only_after_a_silence():
    for silence, heard in ((0.9, False), (1.1, True)):
        messages = MessageFilter(1000)
        for _ in range(int(3 * FASTEST)):
            messages.admits("r", 1, 0.0)
        assert messages.admits("r", 1, silence) is heard


def test_large_messages_are_refused_unread():
    messages = MessageFilter(1000)
    assert messages.admits("r", 1000, 0.0)
    assert not messages.admits("r", 1001, 0.0)
    assert messages.refusals() == [NotTaken("r", "too large", 1)]


def test_a_large_message_counts_as_several():
    messages = MessageFilter(100 * COUNTS_ONCE)
    let_in = sum(messages.admits("r", 100 * COUNTS_ONCE, 0.0) for _ in range(1000))
    assert let_in <= FASTEST / 100
    assert not messages.admits("r", 1, 0.0)


def test_each_channel_has_a_limit_of_its_own():
    messages = MessageFilter(1000, fastest=100.0)
    assert sum(messages.admits("r", 1, 0.0, "all") for _ in range(1000)) == 100
    assert messages.admits("r", 1, 0.0, "to")
    assert messages.admits("other", 1, 0.0, "all")


def test_several_messages_come_as_a_list():
    messages = MessageFilter(1000)
    own, forged = {"kind": "pull", "from": "a"}, {"kind": "pull", "from": "b"}
    assert messages.read("a", json.dumps(own).encode()) == [own]
    assert messages.read("a", json.dumps([own, forged, [own], own]).encode()) == [own, own]
    assert messages.refusals() == [
        NotTaken("a", "in the name of another robot", 1),
        NotTaken("a", "not a JSON object", 1),
    ]
    assert messages.read("a", b"[]") == messages.read("a", b"[") == []


def test_a_message_in_the_name_of_another_robot_is_refused():
    messages = MessageFilter(1000)
    message = {"kind": "pull", "from": "a"}
    body = json.dumps(message).encode()
    assert messages.read("a", body) == [message]
    assert messages.read("b", body) == []
    assert messages.read("b", b"{}") == []
    assert messages.refusals() == [NotTaken("b", "in the name of another robot", 2)]


def test_the_list_of_refusals_is_bounded():
    messages = MessageFilter(1000)
    for number in range(5000):
        messages.refuse("robot %d" % number, "too large")
    assert len(messages.refusals()) <= 1001
    assert sum(r.times for r in messages.refusals()) == 5000


def test_many_senders_share_one_limit():
    messages = MessageFilter(1000)
    let_in = sum(messages.admits("robot %d" % n, 1, 0.0) for n in range(20_000))
    assert let_in <= 1000 + FASTEST


def test_what_is_no_json_object_is_refused():
    for body in (b"", b"[]", b"{", b"\xff", b'{"a": NaN}', b'{"a": %s}' % (b"1" * 31)):
        assert json_object(body) is None
    assert json_object(b"[" * 100_000) is None
    assert json_object(b'{"a":' * 100_000) is None
    assert json_object("") is json_object("[]") is json_object('{"a": NaN}') is None


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(body):
    assert json_object(body) is None or isinstance(json_object(body), dict)
    text = body.decode("utf-8", "replace")
    assert json_object(text) == json_object(text.encode())
