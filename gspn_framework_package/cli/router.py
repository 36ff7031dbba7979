"""``gspn router``: forwards messages between robots without ROS or with separate masters."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time

from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.team.router import Router, router_access
from gspn_framework_package.team.zenoh_session import session_config

_LOOK_PERIOD = 1.0


OPTIONS: Arguments = {
    Argument("--listen", "ENDPOINT", default=[], nargs="+"): (
        "where robots connect (default: tls/0.0.0.0:7447 with keys, otherwise tcp/127.0.0.1:7447)"
    ),
    Argument("--connect", "ENDPOINT", default=[], nargs="+"): "other routers of the team",
    Argument("--keys", "DIR", default=""): "the keys of this router, from 'gspn keys'",
    "--no-limit": "do not drop floods; required without keys if other routers connect to this one",
    "--print-config": (
        "print the configuration of such a router for 'zenohd --config FILE', and exit"
    ),
    "--json": "print JSON, a line for each event",
}

EPILOG = (
    "Without keys, anybody who can reach the router can take part in any run. A changed "
    "team.json in the folder of the keys is applied within a second or two. Exit codes: 0 "
    "ended by the user, 1 cannot listen, 2 wrong keys or endpoints."
)


def run(args: argparse.Namespace) -> int:
    """Route until interrupted; return 0."""
    listen = args.listen or ["tls/0.0.0.0:7447" if args.keys else "tcp/127.0.0.1:7447"]
    if args.print_config:
        access = router_access(listen, args.connect, args.keys, not args.no_limit)
        print(json.dumps(session_config(access), indent=2))
        return 0
    router = Router(listen, args.connect, args.keys, limited=not args.no_limit)
    try:
        _report(args, "listening at %s; %s" % (", ".join(listen), _who(router)), listen=listen)
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                time.sleep(_LOOK_PERIOD)
                news = router.follow_keys()
                if news:
                    _report(args, news, members=router.members)
                for flood in router.floods():
                    _report(args, flood)
    finally:
        router.close()
    return 0


def _who(router: Router) -> str:
    if router.members is None:
        return "no keys: anybody who can reach it can take part"
    return "%d members may take part" % router.members


def _report(args: argparse.Namespace, text: str, **more: object) -> None:
    if args.json:
        print(json.dumps({"told": text, **more}))
    else:
        print("%s  (Ctrl-C ends it)" % text if "listen" in more else text)
    sys.stdout.flush()
