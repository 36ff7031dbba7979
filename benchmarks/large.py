"""How large nets are analysed: each by ``gspn analyse`` in its own process, including reading.

``python3 -m benchmarks.large [NAME ...]``
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict

from benchmarks.harness.processes import peak_mb
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
    answers: Dict[str, Any] = {"states": None, "undecided": {"all": "it failed"}}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "net.pnml"
        write_net(net, path)
        begin = time.monotonic()
        with (Path(folder) / "answers.json").open("w+", encoding="utf-8") as out:
            process = subprocess.Popen(
                [sys.executable, "-m", "gspn_framework_package", "analyse", str(path), "--json"],
                stdout=out,
            )
            _, status, usage = os.wait4(process.pid, 0)
            wall = time.monotonic() - begin
            out.seek(0)
            if status == 0:
                answers = json.load(out)
    states = answers["states"]
    print(
        "| %s | %s | %s | %s | %.1f | %.1f | %.0f | %s |"
        % (
            name,
            format(len(net.places), ","),
            format(len(net.transitions), ","),
            format(states["total"], ",") if states else "-",
            usage.ru_utime + usage.ru_stime,
            wall,
            peak_mb(usage),
            ", ".join(key.replace("_", " ") for key in answers["undecided"]) or "-",
        ),
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
