"""Opens Zenoh sessions: endpoints, mutual TLS, and who may send what.

The names in Zenoh, each of which belongs to one robot (:func:`key_of`)::

    gspn/RUN/ROBOT/all/LANE         protocol messages of ROBOT to everybody
    gspn/RUN/ROBOT/to/OTHER/LANE    protocol messages of ROBOT to OTHER
    gspn/RUN/ROBOT/fired            the firings that ROBOT decided
    gspn/RUN/ROBOT/tasks            the tasks that ended with slots that ROBOT decided
    gspn/RUN/ROBOT/activity         what ROBOT does; also answers queries, with the last one
    gspn/RUN/ROBOT/status           answers queries of watchers
    gspn/RUN/ROBOT/orders/OPERATOR  answers queries of that operator

With keys, every session requires a certificate of the team's authority at both ends, and lets a
robot publish and an operator query only under its own name. Robots connect to routers, which check
their certificates; routers trust each other, and robots trust routers.

The accepting side of a connection, a router or a listening robot, drops messages that arrive faster
than a robot sends (:mod:`~gspn_framework_package.team.lanes`).
"""

from __future__ import annotations

import contextlib
import json
import os
from typing import TYPE_CHECKING, Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple
from urllib.parse import quote, unquote

from gspn_framework_package.model.errors import ExecutionError, UsageError
from gspn_framework_package.team.keys import KeyFolder, KeyHolder
from gspn_framework_package.team.lanes import router_limits
from gspn_framework_package.team.message_filter import LARGEST_MESSAGE

if TYPE_CHECKING:
    import zenoh

_ROOT = "gspn"
_SENDS = ["put", "reply", "declare_queryable"]
_ASKS = ["query"]
_SECURE = "tls/"
_RUNTIME = "ZENOH_RUNTIME"
_chosen: List[bool] = []  # whether a session of this process has read it
_RETRY = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2}


class TeamAccess(NamedTuple):
    """How a process connects to the team.

    ``connect``: endpoints of routers (``tls/HOST:PORT``), which are alternatives. ``listen``:
    endpoints at which this process can be reached. ``keys``: of this member; None for no
    authentication. ``router``: whether it forwards messages. ``patience``: seconds to wait for a
    router that is not there yet; the connection to a router that goes away later is retried
    indefinitely. ``limited``: whether to drop floods on a connection; not for connections from
    routers, which carry the messages of many robots.
    """

    connect: Tuple[str, ...] = ()
    listen: Tuple[str, ...] = ()
    keys: Optional[KeyFolder] = None
    router: bool = False
    patience: float = 0.0
    limited: bool = True


def open_session(access: TeamAccess) -> zenoh.Session:
    """Connect to the team. Do not fork afterwards: a session does not survive a fork.

    :raises UsageError: Zenoh is not installed, or the endpoints do not match the keys.
    :raises ExecutionError: nothing can be reached, or it cannot listen at an endpoint.
    """
    zenoh = zenoh_library()
    config = zenoh.Config.from_json5(json.dumps(session_config(access)))
    try:
        with _threads_chosen(access.router):
            return zenoh.open(config)
    except zenoh.ZError as error:
        raise ExecutionError(
            "cannot open a Zenoh session with %s (%s)" % (_endpoints(access), _reason(error)),
            hint="check that a router runs there ('gspn router') and that the keys belong to its "
            "team",
        ) from None


@contextlib.contextmanager
def _threads_chosen(router: bool) -> Iterator[None]:
    """Set the threads of the first session, unless the user did. Zenoh reads them from the
    environment, which the programs started by actions must not inherit."""
    if _RUNTIME in os.environ or _chosen:
        yield
        return
    _chosen.append(True)
    os.environ[_RUNTIME] = _threads(router)
    try:
        yield
    finally:
        del os.environ[_RUNTIME]


def _threads(router: bool) -> str:
    """Zenoh's setting for a single thread. By default a message passes through four threads, and
    waking each takes longer than its work. A router, which has many connections, may use half of
    the cores.
    """
    number = max(1, (os.cpu_count() or 1) // 2) if router else 1
    others = ["%s: (handover: app)" % name for name in ("acc", "net", "rx", "tx")]
    return "(%s)" % ", ".join(["app: (worker_threads: %d)" % number, *others])


def zenoh_library() -> Any:
    """The module ``zenoh``. :raises UsageError: it is not installed."""
    try:
        import zenoh
    except ImportError as error:
        raise UsageError(
            "the Python library 'zenoh' is not installed (%s)" % error,
            hint="pip install eclipse-zenoh",
        ) from None
    return zenoh


def key_of(run: str, robot: str, *rest: str) -> str:
    """The key of a robot in a run; names may contain any character; "*" matches all."""
    return "/".join(
        [_ROOT, *(part if part == "*" else chunk(part) for part in (run, robot, *rest))]
    )


def chunk(name: str) -> str:
    """Encode a name as one part of a key."""
    return quote(name, safe="") if name != "*" else "%2A"


def names_in_key(key: str) -> List[str]:
    """The names in a key: run, robot and what follows; [] if it is not one of our keys."""
    root, *rest = key.split("/")
    return [unquote(part) for part in rest] if root == _ROOT and len(rest) >= 3 else []


def session_config(access: TeamAccess) -> Dict[str, Any]:
    """The Zenoh configuration of a session.

    :raises UsageError: the endpoints do not match the keys.
    """
    for endpoint in (*access.connect, *access.listen):
        _check_endpoint(endpoint, access.keys)
    if not access.connect and not access.listen:
        raise UsageError("no endpoint to connect to or listen at", hint="tcp/HOST:7447")
    mode = "router" if access.router else "peer" if access.listen else "client"
    link: Dict[str, Any] = {
        "rx": {"max_message_size": 2 * LARGEST_MESSAGE},
        # room for a burst; further messages are dropped
        "tx": {"queue": {"size": {"data_high": 16}}},
    }
    config: Dict[str, Any] = {
        "mode": mode,
        "connect": {"endpoints": list(access.connect), "retry": _RETRY},
        "listen": {"endpoints": list(access.listen)},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"link": link, "shared_memory": {"enabled": False}},
    }
    if mode == "client":
        config["connect"]["timeout_ms"] = int(1000 * access.patience)
    if mode == "router":
        # By default the only thread sleeps for 1 ms before it drops a message, and cannot send
        # anything meanwhile: with a large team on a busy machine the queues filled, and nothing got
        # through
        link["tx"]["queue"]["congestion_control"] = {"drop": {"wait_before_drop": 0}}
        config["low_pass_filter"] = [
            {
                "flows": ["ingress"],
                "messages": ["put", "delete", "query", "reply"],
                "key_exprs": ["**"],
                "size_limit": LARGEST_MESSAGE,
            }
        ]
    if mode != "client" and access.limited:
        lanes = ["%s/*/*/all/%%d" % _ROOT, "%s/*/*/to/*/%%d" % _ROOT]
        config["downsampling"] = router_limits(lanes)
    keys = access.keys
    if keys is not None:
        link["protocols"] = ["tls"]
        link["tls"] = {
            "root_ca_certificate": os.path.abspath(keys.authority),
            "listen_private_key": os.path.abspath(keys.key),
            "listen_certificate": os.path.abspath(keys.certificate),
            "connect_private_key": os.path.abspath(keys.key),
            "connect_certificate": os.path.abspath(keys.certificate),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }
        config["access_control"] = access_control(keys.members)
    return config


def _check_endpoint(endpoint: str, keys: Optional[KeyFolder]) -> None:
    protocol, slash, address = endpoint.partition("/")
    if not slash or not address or not protocol.isalpha():
        raise UsageError("'%s' is not an endpoint" % endpoint, hint="tls/HOST:7447, tcp/HOST:7447")
    if "#" in address or "?" in address:
        raise UsageError("settings are not allowed in an endpoint: '%s'" % endpoint)
    if keys is not None and not endpoint.startswith(_SECURE):
        raise UsageError("keys cannot protect '%s'" % endpoint, hint="use %s..." % _SECURE)
    if keys is None and protocol in ("tls", "quic"):
        raise UsageError("'%s' needs keys" % endpoint, hint="--keys DIR, see 'gspn keys'")


def access_control(members: Sequence[KeyHolder]) -> Dict[str, Any]:
    """The Zenoh access control: everything that is not allowed is denied."""
    rules: List[Dict[str, Any]] = [
        # what anybody may receive, and query
        _rule("out", "egress", ["declare_subscriber", *_SENDS, *_ASKS], ["%s/**" % _ROOT]),
        _rule("listens", "ingress", ["declare_subscriber"], ["%s/**" % _ROOT]),
        _rule("asks", "ingress", _ASKS, [key_of("*", "*", "status"), key_of("*", "*", "activity")]),
        _rule("routes", "ingress", ["declare_subscriber", *_SENDS, *_ASKS], ["%s/**" % _ROOT]),
    ]
    subjects: List[Dict[str, Any]] = []
    policies: List[Dict[str, Any]] = []
    for number, member in enumerate(members):
        subject = "%s %d" % (member.role, number)
        subjects.append({"id": subject, "cert_common_names": [member.common_name]})
        granted = ["out", "listens", "asks"]
        if member.role == "router":
            granted = ["out", "routes"]
        elif member.role == "robot":
            own = "%s/*/%s/**" % (_ROOT, chunk(member.name))
            rules.append(_rule(subject, "ingress", _SENDS, [own]))
            granted.append(subject)
        elif member.role == "operator":
            rules.append(
                _rule(subject, "ingress", _ASKS, [key_of("*", "*", "orders", member.name)])
            )
            granted.append(subject)
        policies.append({"rules": granted, "subjects": [subject]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(name: str, flow: str, messages: List[str], keys: List[str]) -> Dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": keys,
    }


def _endpoints(access: TeamAccess) -> str:
    return ", ".join((*access.connect, *("(here) " + at for at in access.listen)))


def _reason(error: Exception) -> str:
    """The last part of Zenoh's message, which begins with locations in its source."""
    text = " ".join(str(error).split())
    return text.split(" at ", 1)[0][:200]
