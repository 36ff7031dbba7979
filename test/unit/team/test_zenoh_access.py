"""Who can send what through a router: each attempt is made on real sessions."""

import datetime
import os

import pytest
from zenoh_team import Hub, copy_keys, free_port, make_keys, wait_for

from gspn_framework_package.model.errors import ExecutionError, KeysError, UsageError
from gspn_framework_package.team import keys, router, zenoh_session
from gspn_framework_package.team.keys import NewMember
from gspn_framework_package.team.router import Router
from gspn_framework_package.team.zenoh_session import (
    LARGEST_MESSAGE,
    TeamAccess,
    key_of,
    names_in_key,
)

pytestmark = pytest.mark.long


@pytest.fixture
def hub(tmp_path):
    made = Hub(make_keys(tmp_path / "keys"))
    yield made
    made.close()


class Listener:
    """Everything that robot_2 receives."""

    def __init__(self, hub):
        self.got = []
        self.session = hub.session("robot_2")
        self._subscribed = self.session.declare_subscriber(
            "gspn/**", lambda sample: self.got.append((str(sample.key_expr), bytes(sample.payload)))
        )

    def hears(self, session, key, text):
        """Send until it is received: subscriptions take a moment to reach the router."""

        def arrived():
            session.put(key, text)
            return (key, text) in self.got

        wait_for(arrived)


def test_a_robot_speaks_only_under_its_own_name(hub):
    listener = Listener(hub)
    mine, ann, screen = hub.session("robot_1"), hub.session("ann"), hub.session("screen")
    own = key_of("run", "robot_1", "all")
    listener.hears(mine, own, b"1")
    for session in (mine, ann, screen):  # a forged vote
        session.put(key_of("run", "robot_3", "all"), b"forged")
    for session in (ann, screen):
        session.put(own, b"forged")
    listener.hears(mine, own, b"2")
    listener.hears(hub.session("robot_3"), key_of("run", "robot_3", "all"), b"3")
    assert {text for _, text in listener.got} == {b"1", b"2", b"3"}


def test_a_message_of_10_mb_goes_nowhere_and_harms_nobody(hub):
    listener = Listener(hub)
    mine, own = hub.session("robot_1"), key_of("run", "robot_1", "all")
    listener.hears(mine, own, b"before")
    mine.put(own, b"x" * 10_000_000)
    listener.hears(mine, own, b"after")
    assert max(len(text) for _, text in listener.got) < LARGEST_MESSAGE


def ask(session, operator):
    answers = session.get(key_of("run", "robot_2", "orders", operator), timeout=1.0)
    return [bytes(answer.ok.payload) for answer in answers if answer.ok]


def test_only_operators_give_orders_and_only_in_their_own_name(hub):
    asked = []

    def serve(query):
        asked.append(names_in_key(str(query.key_expr))[-1])
        query.reply(query.key_expr, b"done")

    robot = hub.session("robot_2")
    served = robot.declare_queryable(key_of("run", "robot_2", "orders", "*"), serve)
    ann = hub.session("ann")
    wait_for(lambda: ask(ann, "ann") == [b"done"])
    assert ask(ann, "bob") == []
    assert ask(hub.session("screen"), "ann") == []
    assert ask(hub.session("robot_1"), "ann") == []
    assert set(asked) == {"ann"}
    served.undeclare()


def test_strangers_get_no_session(hub, tmp_path):
    others = make_keys(tmp_path / "others")  # the same names, of another authority
    with pytest.raises(ExecutionError, match="cannot open a Zenoh session with tls/127.0.0.1"):
        hub.session("robot_1", others)
    plain = TeamAccess((hub.endpoint.replace("tls/", "tcp/"),))
    with pytest.raises(ExecutionError, match="cannot open a Zenoh session with tcp/127.0.0.1"):
        zenoh_session.open_session(plain)


def test_an_unknown_joiner_of_the_same_authority_is_not_heard(hub):
    """Keys that were made later, which the router does not know."""
    listener = Listener(hub)
    keys.add_members(hub.folder, [NewMember("robot_9", "robot")], 30)
    late = hub.session("robot_9")
    known = hub.session("robot_1")
    late.put(key_of("run", "robot_9", "all"), b"let me in")
    listener.hears(known, key_of("run", "robot_1", "all"), b"1")
    late.put(key_of("run", "robot_9", "all"), b"let me in")
    listener.hears(known, key_of("run", "robot_1", "all"), b"2")
    assert {text for _, text in listener.got} == {b"1", b"2"}
    assert "7 may take part" in hub.router.follow_keys()
    listener.hears(late, key_of("run", "robot_9", "all"), b"now")


def test_a_revoked_robot_is_cut_off_while_the_others_go_on(hub, tmp_path):
    listener = Listener(hub)
    stolen = hub.session("robot_1")
    listener.hears(stolen, key_of("run", "robot_1", "all"), b"1")
    kept = copy_keys(hub.folder, "robot_1", tmp_path / "stolen" / "robot_1")
    keys.revoke(hub.folder, "robot_1")
    assert "5 may take part" in hub.router.follow_keys()
    assert hub.router.follow_keys() == ""
    other = hub.session("robot_3")
    listener.hears(other, key_of("run", "robot_3", "all"), b"2")
    again = hub.session("robot_1", os.path.dirname(kept))  # the thief connects anew
    for session in (stolen, again):
        session.put(key_of("run", "robot_1", "all"), b"stolen")
    listener.hears(other, key_of("run", "robot_3", "all"), b"3")
    assert {text for _, text in listener.got} == {b"1", b"2", b"3"}


def test_a_robot_that_plays_the_router_is_not_believed(tmp_path):
    folder = make_keys(tmp_path / "keys")
    endpoint = "tls/127.0.0.1:%d" % free_port()
    thief = keys.read_keys(os.path.join(folder, "robot_1"))
    played = zenoh_session.open_session(TeamAccess((), (endpoint,), thief, router=True))
    with pytest.raises(ExecutionError):  # its certificate is not for that address
        victim = keys.read_keys(os.path.join(folder, "robot_2"))
        zenoh_session.open_session(TeamAccess((endpoint,), (), victim))
    played.close()


def test_an_expired_certificate_gets_no_session(hub, tmp_path, monkeypatch):
    now = keys._now()
    with monkeypatch.context() as patched:
        patched.setattr(keys, "_now", lambda: now - datetime.timedelta(days=3))
        keys.add_members(hub.folder, [NewMember("robot_9", "robot")], 1)
        expired = keys.read_keys(os.path.join(hub.folder, "robot_9"))
    with pytest.raises(ExecutionError):
        zenoh_session.open_session(TeamAccess((hub.endpoint,), (), expired))


def test_a_router_keeps_its_list_if_the_new_one_cannot_be_read(hub):
    path = os.path.join(hub.folder, "hub", "team.json")
    with open(path, "w") as file:
        file.write("{")
    assert "the previous allow-list stays in force" in hub.router.follow_keys()
    listener = Listener(hub)
    listener.hears(hub.session("robot_1"), key_of("run", "robot_1", "all"), b"1")


def test_a_router_that_cannot_listen_again_tries_once_more(hub, monkeypatch):
    def refuse(access):
        raise ExecutionError("the port is taken")

    keys.revoke(hub.folder, "robot_3")
    with monkeypatch.context() as patched:
        patched.setattr(router, "open_session", refuse)
        assert "the router is down: the port is taken" in hub.router.follow_keys()
    assert "5 may take part" in hub.router.follow_keys()
    listener = Listener(hub)
    listener.hears(hub.session("robot_1"), key_of("run", "robot_1", "all"), b"1")


def test_a_router_takes_the_keys_of_a_router_alone(tmp_path):
    folder = make_keys(tmp_path / "keys")
    with pytest.raises(UsageError, match="keys of robot 'robot_1', not of a router"):
        Router(["tls/127.0.0.1:1"], (), os.path.join(folder, "robot_1"))
    with pytest.raises(KeysError, match="cannot be read"):
        Router(["tls/127.0.0.1:1"], (), str(tmp_path / "none"))


@pytest.mark.parametrize(
    "endpoint, message",
    [
        ("nonsense", "'nonsense' is not an endpoint"),
        ("tcp/", "'tcp/' is not an endpoint"),
        ("tls/127.0.0.1:7447", "needs keys"),
        ("tls/127.0.0.1:7447#verify_name_on_connect=false", "settings are not allowed"),
    ],
)
def test_wrong_endpoints_are_named(endpoint, message):
    with pytest.raises(UsageError, match=message):
        zenoh_session.open_session(TeamAccess((endpoint,)))


def test_keys_are_not_used_in_the_clear(tmp_path):
    own = keys.read_keys(os.path.join(make_keys(tmp_path / "keys"), "robot_1"))
    with pytest.raises(UsageError, match="keys cannot protect 'tcp/"):
        zenoh_session.open_session(TeamAccess(("tcp/127.0.0.1:7447",), (), own))


@pytest.mark.parametrize("name", ["robot_1", "a b", "a/b", "**", "$*", "é", "@x", "?#", "%2A"])
def test_any_name_fits_into_a_key(name):
    import zenoh

    key = key_of("run", name, "to", "other")
    assert str(zenoh.KeyExpr(key)) == key
    assert "*" not in key
    assert names_in_key(key) == ["run", name, "to", "other"]


def test_a_name_is_checked_where_it_comes_in_and_believed_behind_the_next_router(hub):
    keys.add_members(hub.folder, [NewMember("far", "router", ("127.0.0.1",))], 30)
    hub.router.follow_keys()
    endpoint = "tls/127.0.0.1:%d" % free_port()
    far = hub.keep(Router([endpoint], [hub.endpoint], os.path.join(hub.folder, "far")))
    assert far.members == 7
    listener = Listener(hub)
    own = keys.read_keys(os.path.join(hub.folder, "robot_1"))
    distant = hub.keep(zenoh_session.open_session(TeamAccess((endpoint,), (), own)))
    listener.hears(distant, key_of("run", "robot_1", "all"), b"1")
    distant.put(key_of("run", "robot_3", "all"), b"forged")
    listener.hears(distant, key_of("run", "robot_1", "all"), b"2")
    assert {text for _, text in listener.got} == {b"1", b"2"}


def test_robots_without_a_router_check_each_other(tmp_path):
    folder = make_keys(
        tmp_path / "keys",
        [NewMember("robot_1", "robot", ("127.0.0.1",)), NewMember("robot_2", "robot")],
    )
    endpoint, got = "tls/127.0.0.1:%d" % free_port(), []
    first, second = (keys.read_keys(os.path.join(folder, name)) for name in ("robot_1", "robot_2"))
    listens = zenoh_session.open_session(TeamAccess((), (endpoint,), first))
    connects = zenoh_session.open_session(TeamAccess((endpoint,), (), second))
    try:
        subscribed = listens.declare_subscriber(
            "gspn/**", lambda sample: got.append(bytes(sample.payload))
        )

        def arrived(text):
            connects.put(key_of("run", "robot_1", "all"), b"forged")
            connects.put(key_of("run", "robot_2", "all"), text)
            return text in got

        wait_for(lambda: arrived(b"1"))
        wait_for(lambda: arrived(b"2"))
        assert set(got) == {b"1", b"2"}
        subscribed.undeclare()
    finally:
        connects.close()
        listens.close()
