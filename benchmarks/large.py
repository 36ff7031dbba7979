"""How large nets are analysed: each by ``gspn analyse`` in its own process, including reading.

``python3 -m benchmarks.large [NAME ...]``
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any, Dict

from benchmarks.harness.processes import run_verb
from benchmarks.large_nets import LARGE
from gspn_framework_package.formats import write_net


def main() -> int:
    """Print a line for each net."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("names", nargs="*", metavar="NAME", help="among %s" % ", ".join(LARGE))
    names = parser.parse_args().names or list(LARGE)
    for name in names:
        if name not in LARGE:
            parser.error("there is no net '%s'" % name)
    print("load before: %.1f" % os.getloadavg()[0])
    print("| net | places | transitions | states | CPU s | wall s | peak MB | not decided |")
    print("|---|---:|---:|---:|---:|---:|---:|---|")
    for name in names:
        _measure(name)
    print("load after: %.1f" % os.getloadavg()[0])
    return 0


def _measure(name: str) -> None:
    net = LARGE[name]()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "net.pnml"
        write_net(net, path)
        done = run_verb("analyse", str(path), "--json")
    answers: Dict[str, Any] = {"states": None, "undecided": {"all": "it failed"}}
    if done.code == 0:
        answers = json.loads(done.output)
    states = answers["states"]
    print(
        "| %s | %s | %s | %s | %.1f | %.1f | %.0f | %s |"
        % (
            name,
            format(len(net.places), ","),
            format(len(net.transitions), ","),
            format(states["total"], ",") if states else "-",
            done.cpu_seconds,
            done.wall_seconds,
            done.peak_mb,
            ", ".join(key.replace("_", " ") for key in answers["undecided"]) or "-",
        ),
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
