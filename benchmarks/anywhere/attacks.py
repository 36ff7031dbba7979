"""What somebody who should not can try on a team: each attack of ``docs/security.md``, carried out
by one process in a network of its own.

``python3 -m benchmarks.anywhere.attacks NAME --connect ENDPOINT --keys DIR``
prints a JSON object: what the attacker got.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import sys
import time
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence

from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.team.keys import KeyFolder, read_keys, read_team
from gspn_framework_package.team.lanes import LANES
from gspn_framework_package.team.zenoh_session import TeamAccess, key_of, open_session

LISTEN = 2.0
"""Seconds for which an attacker listens before it forges or replays."""

FLOOD = 10_000
"""Messages a second."""

FLOOD_TIME = 8.0
"""Seconds of a flood; the speed of the team is measured for so long with every attack, at least."""

LARGE = 10_000_000
"""Bytes of a large message."""

ANSWER = 3.0
"""Seconds to wait for the answer to an order."""

Found = Dict[str, Any]
"""What an attacker got: ``session`` (whether the router let it in), ``heard`` (messages of the team
that reached it), ``sent``, ``answers`` (to orders)."""


_lanes = itertools.cycle(range(LANES))


def lane() -> str:
    """The next lane, as a robot would take it."""
    return str(next(_lanes))


class Attack(NamedTuple):
    """An attack, and how one sees that it failed; that the team went on is checked as well."""

    what: str
    """What the attacker does, for people."""
    keys: str
    """Whose keys it has: a folder of the demonstration; "" for none."""
    carry_out: Callable[[argparse.Namespace], Found]
    failed: Callable[[Found], bool]
    """Whether the attacker got nothing."""


def _access(args: argparse.Namespace) -> TeamAccess:
    return TeamAccess((args.connect,), (), _taken(args.keys) if args.keys else None)


def _taken(folder: str) -> KeyFolder:
    """The keys in a folder, without a look at whether they are still valid."""
    rows = [row for row in read_team(folder) if not row.revoked]
    name = os.path.basename(folder)
    return KeyFolder(folder, next(row for row in rows if row.name == name), tuple(rows))


@contextlib.contextmanager
def _listening(args: argparse.Namespace) -> Iterator[Any]:
    """A session, and what it hears of the run."""
    session = open_session(_access(args))
    heard: List[bytes] = []
    listening = session.declare_subscriber(
        key_of(args.run, "*") + "/**",
        lambda sample: heard.append(bytes(sample.payload)),
    )
    time.sleep(LISTEN)
    try:
        yield session, heard
    finally:
        listening.undeclare()
        session.close()


def _messages(heard: List[bytes]) -> List[Dict[str, Any]]:
    """The protocol messages among what was heard; several that were sent as one come apart."""
    found: List[Dict[str, Any]] = []
    for body in heard:
        with contextlib.suppress(ValueError):
            value = json.loads(body)
            found += [m for m in (value if isinstance(value, list) else [value]) if "kind" in m]
    return found


def enter(args: argparse.Namespace) -> Found:
    """Try to get in; listen, and speak as robot_1."""
    try:
        with _listening(args) as (session, heard):
            got = len(heard)  # before it hears itself
            body = json.dumps({"from": "robot_1", "kind": "hello"}).encode()
            session.put(key_of(args.run, "robot_1", "all", lane()), body)
            return {"session": True, "heard": got, "sent": 1}
    except ExecutionError as error:
        return {"session": False, "heard": 0, "sent": 0, "why": error.message}


def forge(args: argparse.Namespace) -> Found:
    """Send the votes of another robot, as they were recorded and with other ballots, under its name
    and under the own one."""
    with _listening(args) as (session, heard):
        sent = 0
        for message in [m for m in _messages(heard) if m.get("from") == args.victim][-200:]:
            bodies = [json.dumps(message).encode()]
            if isinstance(message.get("ballot"), list):
                message["ballot"][0] += 1000
                bodies.append(json.dumps(message).encode())
            for body in bodies:
                session.put(key_of(args.run, args.victim, "all", lane()), body)
                session.put(key_of(args.run, args.victim, "to", "robot_1", lane()), body)
                session.put(key_of(args.run, args.name, "all", lane()), body)
                sent += 3
        return {"session": True, "heard": len(heard), "sent": sent}


def other_plan(args: argparse.Namespace) -> Found:
    """Use the name of the run with another plan and another log."""
    with _listening(args) as (session, heard):
        messages = _messages(heard)[-200:]
        for message in messages:
            stolen = {**message, "from": args.name, "log": "another"}
            if "team" in stolen:
                stolen["team"] = args.run + "|another plan"
            session.put(key_of(args.run, args.name, "all", lane()), json.dumps(stolen).encode())
        return {"session": True, "heard": len(heard), "sent": len(messages)}


def order(args: argparse.Namespace) -> Found:
    """Give orders: in the own name, and in an operator's."""
    session = open_session(_access(args))
    answers: List[str] = []
    for operator in (args.name, args.operator):
        key = key_of(args.run, "robot_1", "orders", operator)
        given = json.dumps({"command": "pause", "robot": "", "argument": ""}).encode()
        for reply in session.get(key, payload=given, timeout=ANSWER):
            if reply.ok is not None:
                answers.append(bytes(reply.ok.payload).decode("utf-8", "replace"))
    session.close()
    return {"session": True, "sent": 2, "answers": answers}


def flood(args: argparse.Namespace) -> Found:
    """10,000 messages a second for some seconds."""
    session = open_session(_access(args))
    publishers = [
        session.declare_publisher(key_of(args.run, args.name, "all", str(k)), express=True)
        for k in range(LANES)
    ]
    body = json.dumps({"from": args.name, "kind": "hello", "text": "x" * 500}).encode()
    began = time.monotonic()
    sent = 0
    while time.monotonic() < began + FLOOD_TIME:
        due = int((time.monotonic() - began) * FLOOD)
        while sent < due:
            publishers[sent % LANES].put(body)
            sent += 1
        time.sleep(0.005)
    session.close()
    return {"session": True, "sent": sent}


def large(args: argparse.Namespace) -> Found:
    """Messages of 10 MB."""
    session = open_session(_access(args))
    for _ in range(5):
        session.put(key_of(args.run, args.name, "all", lane()), b"x" * LARGE)
    time.sleep(1.0)  # a session that closes at once sends none of it
    session.close()
    return {"session": True, "sent": 5}


def play_router(args: argparse.Namespace) -> Found:
    """Be the router, for a robot that comes by: it has the keys of the victim, which connects."""
    own = _taken(args.keys)
    endpoint = "tls/%s:7448" % args.address
    played = open_session(TeamAccess((), (endpoint,), own, router=True))
    try:
        victim = read_keys(args.victim_keys)
        open_session(TeamAccess((endpoint,), (), victim)).close()
        return {"session": True}
    except ExecutionError as error:
        return {"session": False, "why": error.message}
    finally:
        played.close()


def _kept_out(found: Found) -> bool:
    return not found["session"]


def _not_heard(found: Found) -> bool:
    return not found["heard"]


def _tried(found: Found) -> bool:
    return bool(found["sent"])


def _unanswered(found: Found) -> bool:
    return bool(found["sent"]) and not found["answers"]


STOLEN = "robot_9"
"""A member whose keys somebody took: a robot that is not in the plan."""

ATTACKS: Dict[str, Attack] = {
    "no keys": Attack("connects without TLS", "", enter, _kept_out),
    "another authority": Attack(
        "has keys of the same names, of another team", "others/robot_1", enter, _kept_out
    ),
    "expired": Attack("has keys that ended yesterday", "expired/robot_1", enter, _kept_out),
    "unknown joiner": Attack(
        "has keys that the router does not know", "later/robot_8", enter, _not_heard
    ),
    "forged and replayed votes": Attack(
        "sends recorded and changed votes of another robot", "keys/" + STOLEN, forge, _tried
    ),
    "stolen run name": Attack(
        "speaks of another plan and log in the same run", "keys/" + STOLEN, other_plan, _tried
    ),
    "a robot gives orders": Attack(
        "asks to pause, in its own name and an operator's", "keys/" + STOLEN, order, _unanswered
    ),
    "a watcher gives orders": Attack(
        "asks to pause, in its own name and an operator's", "keys/screen", order, _unanswered
    ),
    "a robot plays the router": Attack(
        "listens with a robot's keys; another robot connects", "keys/" + STOLEN, play_router,
        _kept_out,
    ),
    "large messages": Attack("sends messages of 10 MB", "keys/" + STOLEN, large, _tried),
    "flood": Attack("sends 10,000 messages a second", "keys/" + STOLEN, flood, _tried),
    "revoked": Attack("has keys that were revoked", "revoked/" + STOLEN, enter, _not_heard),
}  # fmt: skip
"""In the order in which they are tried; the last one after its keys have been revoked."""


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Carry one attack out, and print what came of it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("attack", choices=list(ATTACKS))
    parser.add_argument("--connect", required=True, metavar="ENDPOINT")
    parser.add_argument("--keys", default="", metavar="DIR")
    parser.add_argument("--run", required=True, metavar="NAME")
    parser.add_argument("--name", default=STOLEN, help="who the attacker is")
    parser.add_argument("--operator", default="ann", help="an operator of the team")
    parser.add_argument("--victim", default="robot_2", help="in whose name it speaks")
    parser.add_argument("--victim-keys", default="", metavar="DIR", help="keys of another robot")
    parser.add_argument("--address", default="127.0.0.1", help="its own address")
    args = parser.parse_args(arguments)
    print(json.dumps(ATTACKS[args.attack].carry_out(args)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
