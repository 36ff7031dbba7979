"""What the key of a team keeps out: texts without it, of another run, changed, or played again."""

import os
import stat

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.cli.main import main
from gspn_framework_package.model.errors import KeysError
from gspn_framework_package.team.seal import (
    FRESH,
    WINDOW,
    NotSealedError,
    Seal,
    TeamKey,
    is_sealed,
    make_team_key,
    read_team_key,
)

KEY, OTHER_KEY = TeamKey(b"k" * 32), TeamKey(b"o" * 32)


class Clock:
    def __init__(self, now=1e9):
        self.now = now

    def __call__(self):
        return self.now


def seal(name, run="run", key=KEY, clock=None):
    return Seal(key, run, name, clock or Clock())


def why_not(receiver, text, purpose="said"):
    with pytest.raises(NotSealedError) as error:
        receiver.open(text, purpose)
    return error.value.why


@pytest.mark.parametrize("to", ["", "a"])
@pytest.mark.parametrize("sender", ["b", "a robot", "ü/#", "-", ""])
def test_what_was_sealed_opens(sender, to):
    text = seal(sender).close(to, '{"x":\n1}', "said")
    assert is_sealed(text) and not is_sealed('{"x":1}')
    assert seal("a").open(text, "said") == (sender, '{"x":\n1}')


def test_what_was_not_sealed_for_us_does_not_open():
    text = seal("b").close("a", "body", "said")
    assert why_not(seal("a"), "{}") == why_not(seal("a"), "") == "without the key of the team"
    forged = "not sealed with the key of this team and run"
    assert why_not(seal("a", key=OTHER_KEY), text) == forged
    assert why_not(seal("a", run="another"), text) == forged
    assert why_not(seal("a"), text, "asked") == forged
    assert why_not(seal("c"), text) == "a message for another robot"


@settings(derandomize=True, deadline=None)
@given(st.data())
def test_a_changed_text_does_not_open(data):
    text = seal("b").close("", '{"kind": "accepted"}', "said")
    at = data.draw(st.integers(0, len(text) - 1))
    new = data.draw(st.characters().filter(lambda c: c != text[at]))
    why_not(seal("a"), text[:at] + new + text[at + 1 :])


def test_a_message_counts_once_in_whatever_order_it_comes():
    sender, receiver = seal("b"), seal("a")
    texts = [sender.close("", str(n), "said") for n in range(200)]
    receiver.open(texts[100], "said")
    for n in (130, 120, 129, 131, 195):
        assert receiver.open(texts[n], "said").body == str(n)
    for n in (130, 120, 129, 131, 195, 99):
        assert why_not(receiver, texts[n]) in ("a repeated message", "too late")
    assert why_not(receiver, texts[195 - WINDOW]) == "too late"
    assert receiver.open(texts[195 - WINDOW + 1], "said").body == str(195 - WINDOW + 1)


@settings(derandomize=True, deadline=None)
@given(st.lists(st.integers(0, 150), max_size=60))
def test_no_order_of_arrival_lets_one_in_twice(order):
    sender, receiver = seal("b"), seal("a")
    texts = [sender.close("", str(n), "said") for n in range(151)]
    opened = []
    for n in order:
        try:
            opened.append(receiver.open(texts[n], "said").body)
        except NotSealedError:
            assert opened  # the first one opens
    assert len(opened) == len(set(opened))


def test_what_was_recorded_before_the_first_message_that_came_does_not_count():
    sender, receiver = seal("b"), seal("a")
    texts = [sender.close("", str(n), "said") for n in range(WINDOW)]
    receiver.open(texts[-1], "said")
    for text in texts[:-1]:
        assert why_not(receiver, text) == "a repeated message"


def test_clocks_may_differ_by_so_much_and_no_more():
    clock = Clock()
    robot = seal("a", clock=clock)
    clock.now += 10 * FRESH
    for by in (FRESH, -FRESH):
        near = seal("b", clock=Clock(clock.now + by))
        assert robot.open(near.close("", "body", "said"), "said").body == "body"
        assert robot.open_order(near.close("a", "stop", "order"), "order").body == "stop"
    for by in (FRESH + 1, -FRESH - 1):
        far = seal("b", clock=Clock(clock.now + by))
        assert "the clocks differ" in why_not(robot, far.close("", "body", "said"))
        with pytest.raises(NotSealedError, match="the clocks differ"):
            robot.open_order(far.close("a", "stop", "order"), "order")


def test_nothing_that_is_sealed_runs_into_what_follows():
    """The code covers where the run and the purpose end."""
    forged = "not sealed with the key of this team and run"
    magic, code, session, rest = seal("b").close("", "body", "said").split(" ", 3)
    moved = " ".join([magic, code, session[1:], rest])
    assert why_not(seal("a"), moved, "said" + session[0]) == forged
    magic, code, session, rest = seal("b", run="x1:y").close("", "body", "said").split(" ", 3)
    moved = " ".join([magic, code, "4:said" + session, rest])
    assert why_not(seal("a", run="x"), moved, "y") == forged


@pytest.mark.parametrize("number, time", [("one", "1"), ("1", "soon"), ("1", "9" * 400)])
def test_a_line_without_numbers_is_refused_though_it_has_the_key(number, time):
    line = "%s %s %s b. ." % ("session", number, time)
    text = "gspn1 %s %s\nbody" % (KEY.code("3:run4:said%s\nbody" % line), line)
    assert why_not(seal("a"), text) == "its number or time is not a number"


def test_messages_to_others_do_not_push_ours_out_of_the_window():
    sender, receiver = seal("b"), seal("a")
    mine = [sender.close("a", str(n), "said") for n in range(2)]
    for _ in range(2 * WINDOW):
        receiver.open(sender.close("", "all", "said"), "said")
        sender.close("c", "other", "said")
    assert [receiver.open(text, "said").body for text in mine] == ["0", "1"]


def test_a_restarted_sender_is_heard_and_its_recorded_former_life_is_not():
    clock = Clock()
    receiver = seal("a", clock=clock)
    former = seal("b", clock=clock)
    recorded = [former.close(to, "old", "said") for to in ("", "a") for _ in range(3)]
    receiver.open(recorded[0], "said")
    clock.now += 60.0
    assert receiver.open(seal("b", clock=clock).close("", "new", "said"), "said").body == "new"
    # before one that has come, or of a stream that it does not know and that is old
    assert why_not(receiver, recorded[0]) == "a repeated message"
    assert "60 s old" in why_not(receiver, recorded[3])
    restarted = seal("a", clock=clock)
    for text in recorded:
        assert "it was recorded earlier, or the clocks differ" in why_not(restarted, text)


def test_two_processes_of_one_name_are_both_heard():
    receiver, one, two = seal("a"), seal("b"), seal("b")
    for _ in range(5):
        assert receiver.open(one.close("", "1", "said"), "said").body == "1"
        assert receiver.open(two.close("", "2", "said"), "said").body == "2"


def test_an_order_counts_once_at_one_robot_and_not_for_long():
    clock = Clock()
    robots = [seal(name, clock=clock) for name in ("a", "b")]
    clock.now += 1.0
    ann = seal("ann", clock=clock)
    order = ann.close("a", "stop", "order")
    assert robots[0].open_order(order, "order") == ("ann", "stop")

    def why(robot, text):
        with pytest.raises(NotSealedError) as error:
            robot.open_order(text, "order")
        return error.value.why

    assert why(robots[0], order) == "a repeated order"
    assert why(robots[1], order) == "a message for another robot"
    assert why(robots[1], ann.close("", "stop", "order")) == "an order for another robot"
    late, later = ann.close("b", "stop", "order"), ann.close("b", "stop", "order")
    clock.now += FRESH - 1
    assert robots[1].open_order(late, "order").body == "stop"
    clock.now += 2
    assert "31 s old" in why(robots[1], later)
    restarted = seal("b", clock=clock)
    clock.now += 1
    fresh = ann.close("b", "stop", "order")
    assert restarted.open_order(fresh, "order").body == "stop"
    restarted = seal("b", clock=Clock(clock.now + 1))
    assert why(restarted, fresh) == "an order from before this robot started"


def test_an_order_is_remembered_for_as_long_as_it_could_be_played_again():
    """Up to twice :data:`FRESH`, where the clock of the operator is ahead."""
    clock = Clock()
    robot, ann = seal("a", clock=clock), seal("ann", clock=Clock(clock.now + FRESH))
    order = ann.close("a", "stop", "order")
    assert robot.open_order(order, "order").body == "stop"
    for _ in range(4):
        clock.now += FRESH / 2
        with pytest.raises(NotSealedError, match="a repeated order"):
            robot.open_order(order, "order")
    clock.now += 1
    with pytest.raises(NotSealedError, match="31 s old"):
        robot.open_order(order, "order")


def test_a_key_is_for_its_owner_alone_and_nothing_is_overwritten(tmp_path, capsys):
    path = str(tmp_path / "team.key")
    assert main(["keys", "shared", path]) == 0
    assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
    key = read_team_key(path)
    with open(path) as file:
        secret = file.read().strip()
    assert len(secret) == 64 and secret not in repr(key) + str(vars(seal("a", key=key)))
    assert secret not in "".join(capsys.readouterr())
    assert main(["keys", "shared", path]) == 2
    assert "already exists" in capsys.readouterr().err
    os.chmod(path, 0o640)
    with pytest.raises(KeysError, match="other users can read this private key"):
        read_team_key(path)


@pytest.mark.parametrize(
    ("content", "says"),
    [(None, "cannot be read"), ("hello", "not a team key"), ("ab" * 31, "at least 64"), ("", "64")],
)
def test_what_is_no_key_is_refused(tmp_path, content, says):
    path = tmp_path / "team.key"
    if content is not None:
        path.write_text(content)
        path.chmod(0o600)
    with pytest.raises(KeysError, match=says):
        read_team_key(str(path))


def test_two_keys_differ(tmp_path):
    for name in ("one", "two"):
        make_team_key(str(tmp_path / name))
    assert (tmp_path / "one").read_text() != (tmp_path / "two").read_text()
