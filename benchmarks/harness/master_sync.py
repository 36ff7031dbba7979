"""Brings what the nodes of other ROS masters offer to the own master, as ``fkie_multimaster`` does,
for tests of teams with a master on each robot.

``python3 -m benchmarks.harness.master_sync URI URI ...``: the own master, then
the others. Only the topics and services that docs/own_robots.md names are synchronised.
"""

from __future__ import annotations

import fnmatch
import socket
import sys
import time
import xmlrpc.client
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Set
from urllib.parse import urlparse

TOPICS = ("/gspn_agreement", "/fired_transitions", "/*/agreement")
SERVICES = ("/*/get_place", "/*/get_state", "/*/set_place")

PERIOD = 0.5
"""Seconds between two looks at a master."""

AWAY = 2.0
"""Seconds without an answer after which what a master's nodes offer is taken back."""

ANSWER = 1.0
"""Seconds to wait for an answer of a master."""

_SELF = "/gspn_master_sync"


class Offer(NamedTuple):
    """What a node registered. ``kind``: ``Publisher``, ``Subscriber`` or ``Service``. ``name``: of
    the topic or service. ``api``: of the node. ``more``: the topic's type, or the service's
    address."""

    kind: str
    node: str
    name: str
    more: str
    api: str


def offers_of(
    state: Sequence[Any], types: Dict[str, str], apis: Dict[str, str], services: Dict[str, str]
) -> Set[Offer]:
    """What a master's own nodes offer of what is synchronised.

    :param state: publishers, subscribers and services, each a list of [name, nodes].
    :param types: type of each topic.
    :param apis: node -> its API, for the nodes of that machine alone.
    :param services: service -> its address.
    """
    found: Set[Offer] = set()
    for kind, names, wanted in zip(
        ("Publisher", "Subscriber", "Service"), state, (TOPICS, TOPICS, SERVICES)
    ):
        for name, nodes in names:
            if not any(fnmatch.fnmatchcase(name, pattern) for pattern in wanted):
                continue
            more = services.get(name, "") if kind == "Service" else types.get(name, "*")
            found |= {Offer(kind, n, name, more, apis[n]) for n in nodes if n in apis and more}
    return found


class _Master:
    """A master, asked over XML-RPC; every call fails after :data:`ANSWER` seconds."""

    def __init__(self, uri: str) -> None:
        self.host = urlparse(uri).hostname
        self._proxy: Any = xmlrpc.client.ServerProxy(uri)
        self.seen = time.monotonic()

    def call(self, name: str, *arguments: str) -> Any:
        """The value of a call. :raises OSError: no answer, or an error."""
        try:
            code, text, value = getattr(self._proxy, name)(_SELF, *arguments)
        except (xmlrpc.client.Error, ValueError) as error:
            raise OSError(str(error)) from None
        if code != 1:
            raise OSError(text)
        return value

    def offers(self) -> Set[Offer]:
        """What its own nodes offer. :raises OSError: no answer."""
        state = self.call("getSystemState")
        types = dict(self.call("getTopicTypes"))
        nodes = {node for names in state for _, found in names for node in found}
        apis = {node: self._found("lookupNode", node) for node in nodes}
        own = {n: api for n, api in apis.items() if api and urlparse(api).hostname == self.host}
        services = {name: self._found("lookupService", name) for name, _ in state[2]}
        self.seen = time.monotonic()
        return offers_of(state, types, own, services)

    def _found(self, call: str, name: str) -> str:
        try:
            return str(self.call(call, name))
        except OSError:  # it is gone
            return ""

    def add(self, offer: Offer) -> None:
        """Register an offer of another master's node."""
        self._as_node(offer, "register", offer.name, offer.more, offer.api)

    def remove(self, offer: Offer) -> None:
        """Take it back."""
        last = offer.more if offer.kind == "Service" else offer.api
        self._as_node(offer, "unregister", offer.name, last)

    def _as_node(self, offer: Offer, verb: str, *words: str) -> None:
        getattr(self._proxy, verb + offer.kind)(offer.node, *words)


def keep_in_step(own: _Master, others: List[_Master], there: Dict[int, Set[Offer]]) -> None:
    """One look at every master.

    :param there: number of another master -> what of it is registered here; updated.
    """
    for number, other in enumerate(others):
        before = there.get(number, set())
        now: Optional[Set[Offer]] = None
        try:
            now = other.offers()
        except OSError:
            if time.monotonic() - other.seen > AWAY:
                now = set()
        if now is None:
            continue
        try:
            for offer in sorted(before - now):
                own.remove(offer)
            for offer in sorted(now - before):
                own.add(offer)
        except (OSError, xmlrpc.client.Error):  # once more the next time
            continue
        there[number] = now


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Synchronise until the process is ended."""
    uris = list(arguments if arguments is not None else sys.argv[1:])
    socket.setdefaulttimeout(ANSWER)
    own, *others = [_Master(uri) for uri in uris]
    there: Dict[int, Set[Offer]] = {}
    while True:
        keep_in_step(own, others, there)
        time.sleep(PERIOD)


if __name__ == "__main__":
    sys.exit(main())
