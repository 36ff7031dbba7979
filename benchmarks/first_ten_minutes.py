"""The first ten minutes of five people, beside py_trees and stormpy:
``python3 -m benchmarks.first_ten_minutes [--json] [NAME ...]``.

For each of them an empty environment is made, the checkout is installed as the page says that the
person reads first, and the commands of that page are typed, one after the other. What they print is
checked. Then the same for the first steps of the two libraries. The exit code is 1 if something
failed.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

from benchmarks.machine import describe_machine, machine_line, table

ROOT = Path(__file__).resolve().parents[1]
INSTALLED = ("gspn", "gspn_framework_package", "docs", "msg", "plans")
FILES = ("setup.py", "package.xml", "pyproject.toml", "LICENSE", "README.md")
"""Folders and files of a checkout from which pip installs."""

EXPECTED = {
    "analyse": r"deadlock",
    "check": r"may run",
    "history": r"slots new|robot|visits",
    "import": r"gspn check",
    "new": r"Next: gspn check",
    "optimise": r"reward",
    "run": r"ended: ",
    "simulate": r"±|firings|written",
    "verify": r"(?m)^valid",
}
"""Verb -> what its output has to hold."""

PATIENCE = 600.0
"""Longest time for a step (s)."""


class Person(NamedTuple):
    """Somebody who begins.

    :ivar page: the page of ``docs`` that this person reads first; None: ``steps`` instead.
    :ivar section: the heading below which its commands are; "": those of the whole page.
    :ivar library: what pip installs instead of this package.
    :ivar steps: pairs of a command and what its output has to hold.
    """

    page: Optional[str] = None
    section: str = ""
    library: str = ""
    steps: Tuple[Tuple[str, str], ...] = ()


_STORMPY = """import stormpy, stormpy.examples, stormpy.examples.files as files
program = stormpy.parse_prism_program(files.prism_dtmc_die)
asked = stormpy.parse_properties('P=? [F "one"]', program)
model = stormpy.build_model(program, asked)
print(stormpy.model_checking(model, asked[0]).get_value(model.initial_states[0]))"""

PEOPLE: Dict[str, Person] = {
    "student": Person("for_students.md"),
    "engineer": Person("for_engineers.md"),
    "researcher": Person("for_researchers.md"),
    "SMACH user": Person("behaviour_trees.md", "## SMACH"),
    "fleet operator": Person("history.md"),
    "py_trees": Person(
        library="py_trees", steps=(("py-trees-demo-behaviour-lifecycle", "Status.SUCCESS"),)
    ),
    "stormpy": Person(
        library="stormpy", steps=(("python -c %s" % shlex.quote(_STORMPY), r"0\.16666"),)
    ),
}


def steps_of(person: Person, folder: Path) -> List[Tuple[str, str]]:
    """The commands that a person types, with what their output has to hold; the files that the
    page has for them are written into the folder."""
    if person.page is None:
        return list(person.steps)
    text = (ROOT / "docs" / person.page).read_text("utf-8")
    if person.section:
        text = text.split(person.section + "\n")[1].split("\n## ")[0]
    for name, body in re.findall(r"(?ms)^:caption: (\S+)\n\n(.*?)^```", text):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(body, "utf-8")
    blocks = re.findall(r"(?m)^```\w+\n((?:(?:gspn|pip install) .*\n)+)```", text)
    lines: List[str] = []
    while blocks and not any(line.startswith("gspn") for line in lines):
        lines += blocks.pop(0).splitlines()
    return [(line, EXPECTED.get(line.split()[1], "")) for line in lines]


def first_steps(person: Person, folder: Path) -> Dict[str, Any]:
    """Install what a person needs and type the commands. Returns the seconds on the clock at the
    end of each step, the size of what was installed, and what failed."""
    environment, work = folder / "venv", folder / "work"
    work.mkdir()
    shutil.copytree(ROOT / "plans", work / "plans", ignore=shutil.ignore_patterns("runs"))
    wanted = person.library or str(_copy_of_checkout(folder / "checkout"))
    typed = [
        ("python3 -m venv", [sys.executable, "-m", "venv", str(environment)], ""),
        ("pip install", [str(environment / "bin/pip"), "install", "-q", wanted], ""),
    ]
    typed += [(line, ["bash", "-c", line], holds) for line, holds in steps_of(person, work)]
    began, told = time.monotonic(), []
    for line, words, holds in typed:
        started = time.monotonic()
        failure = _type(words, work, environment, holds)
        now = time.monotonic()
        told.append(
            {"typed": line, "seconds": now - started, "clock": now - began, "failure": failure}
        )
        if failure:
            break
    return {"steps": told, "megabytes": _megabytes(environment)}


def _type(words: Sequence[str], work: Path, environment: Path, holds: str) -> str:
    """Run a command; returns what is wrong with it, "" if nothing."""
    surroundings = {
        "HOME": str(work),
        "LC_ALL": "C.UTF-8",
        "PATH": "%s:/usr/bin:/bin" % (environment / "bin"),
    }
    for name, value in os.environ.items():
        if name.startswith(("PIP_", "SSL_", "REQUESTS_")) or name.lower().endswith("_proxy"):
            surroundings[name] = value
    try:
        done = subprocess.run(
            words,
            cwd=str(work),
            env=surroundings,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=PATIENCE,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "not done after %g s" % PATIENCE
    said = done.stdout.decode("utf-8", "replace")
    if done.returncode:
        return "exit code %d: %s" % (done.returncode, " ".join(said.split()[-40:]))
    return "" if re.search(holds, said) else "does not say %s: %s" % (holds, said[-300:])


def _copy_of_checkout(target: Path) -> Path:
    """pip would leave files of its own in the checkout."""
    for name in INSTALLED:
        shutil.copytree(ROOT / name, target / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        shutil.copy(ROOT / name, target / name)
    return target


def _megabytes(folder: Path) -> float:
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return sum(path.stat().st_blocks for path in files) * 512 / 2**20


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark; returns 1 if something failed."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.first_ten_minutes", description="the first ten minutes of five people"
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(PEOPLE) + " (all)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    unknown = set(args.names) - set(PEOPLE)
    if unknown:
        parser.error("nobody is called %s" % ", ".join(sorted(unknown)))
    told: Dict[str, Any] = {}
    for name in args.names or PEOPLE:
        print("first_ten_minutes: %s" % name, file=sys.stderr)
        with tempfile.TemporaryDirectory() as folder:
            told[name] = first_steps(PEOPLE[name], Path(folder))
    if args.json:
        print(json.dumps({"machine": describe_machine(()), "people": told}, indent=2))
    else:
        _print(told)
    return int(any(step["failure"] for one in told.values() for step in one["steps"]))


def _print(told: Dict[str, Any]) -> None:
    head = ["who", "installed after s", "MB", "first answer after s", "all after s", "commands"]
    rows: List[List[Any]] = []
    for name, one in told.items():
        clocks = ["%.0f" % step["clock"] for step in one["steps"]] + ["-"] * 2
        last = clocks[len(one["steps"]) - 1]
        size = "%.0f" % one["megabytes"]
        rows.append([name, clocks[1], size, clocks[2], last, len(one["steps"]) - 2])
    print(machine_line(describe_machine(())) + "\n\n" + table(head, rows) + "\n")
    for name, one in told.items():
        print(name)
        for step in one["steps"]:
            said = " FAILED: %s" % step["failure"] if step["failure"] else ""
            line = step["typed"].splitlines()[0]
            print("  %3d:%02d  %s%s" % (*divmod(int(step["clock"]), 60), line, said))


if __name__ == "__main__":
    sys.exit(main())
