"""Somebody who watches a run over Zenoh: prints each second how many firings it saw."""

from __future__ import annotations

import argparse
import sys
import time

from gspn_framework_package.team.keys import read_keys
from gspn_framework_package.team.zenoh_session import TeamAccess
from gspn_framework_package.team.zenoh_watch import Sights, ZenohWatch


def main() -> int:
    """Watch until the process is ended."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--connect", required=True, metavar="ENDPOINT")
    parser.add_argument("--keys", required=True, metavar="DIR")
    parser.add_argument("--run", required=True, metavar="NAME")
    args = parser.parse_args()
    seen = [0]

    def fired(robot: str, fields: object) -> None:
        seen[0] += 1

    access = TeamAccess((args.connect,), (), read_keys(args.keys), patience=30.0)
    watch = ZenohWatch(access, args.run, Sights(fired, lambda robot, fields: None))
    try:
        while True:
            print(seen[0], flush=True)
            time.sleep(1.0)
    finally:
        watch.close()


if __name__ == "__main__":
    sys.exit(main())
