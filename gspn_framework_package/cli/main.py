"""The dispatcher of the command line: finds the module of the requested verb and runs it.

A verb is a module with ``OPTIONS``, perhaps an ``EPILOG`` of its help, and ``run(args) -> int``,
and a row of :data:`VERB_GROUPS`, or an order to a team. A module whose options are in groups has
``add_arguments(parser)`` instead. Only the module of the requested verb is imported, so that
``gspn --help`` and simple verbs start quickly.

Exit codes: 0 the answer is yes, 1 the answer is no or a plan was refused, 2 the input or the usage
is wrong, 70 internal error, 130 interrupted, 141 the reader of the output has exited.
"""

from __future__ import annotations

import argparse
import difflib
import errno
import importlib
import io
import os
import re
import signal
import sys
import textwrap
import traceback
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    Mapping,
    NamedTuple,
    NoReturn,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from gspn_framework_package import __version__
from gspn_framework_package.cli.interrupts import EXIT_INTERRUPTED, INTERRUPTED_MESSAGE, Interrupts
from gspn_framework_package.cli.options import add_options
from gspn_framework_package.execution.plan_modules import allow_modules
from gspn_framework_package.model.errors import GspnError, missing_library

if TYPE_CHECKING:
    from gspn_framework_package.cli.orders import OrderVerb

EXIT_USAGE = 2
EXIT_INTERNAL = 70  # EX_SOFTWARE of sysexits.h
EXIT_BROKEN_PIPE = 141  # 128 + SIGPIPE

_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""The errors of a full or broken disk."""


class Verb(NamedTuple):
    """A verb with its own module.

    :ivar module: the full name of the module or, with a leading dot, its name in this package.
    :ivar help: what the verb does, in one line.
    :ivar example: the words of a command line.
    """

    module: str
    help: str
    example: str = ""

    def load(self) -> Any:
        """Import and return the module, which declares the verb's arguments and runs it."""
        return importlib.import_module(self.module, __package__)


OPERATE = "operate a running team"

VERB_GROUPS: Dict[str, Dict[str, Verb]] = {
    "make a plan": {
        "new": Verb(
            ".new",
            "write a starter plan: patrol, inspect, deliver, charge, rendezvous",
            "new patrol my_patrol --places door window gate --robots 3",
        ),
        "build": Verb(
            ".build",
            "build a plan from a topological map and its tasks",
            "build site.tmap2 --tasks tasks.yaml -o site",
        ),
        "import": Verb(
            ".importing",
            "make a plan from a behaviour tree (BehaviorTree.CPP, py_trees) or SMACH machine",
            "import tree.xml -o my_plan --robots 2",
        ),
        "check": Verb(
            ".check", "check whether a plan may run, before any robot moves", "check my_patrol"
        ),
        "explain": Verb(
            ".explain",
            "play a firing sequence step by step, such as that of a finding of check",
            "explain my_patrol arrive leave",
        ),
        "draw": Verb(
            ".draw",
            "draw a net, its coverability tree or its Markov chain",
            "draw my_patrol -o net.svg",
        ),
        "diff": Verb(
            ".diff",
            "compare two plans or nets: what was added, removed and changed",
            "diff my_patrol better.json",
        ),
        "convert": Verb(
            ".convert",
            "write a net in another format, or a plan as one file",
            "convert my_patrol net.pnml",
        ),
    },
    "predict and improve it": {
        "analyse": Verb(
            ".analyse",
            "analyse a net, or a plan under its policy: structure, state space, time",
            "analyse my_patrol --robots 2",
        ),
        "simulate": Verb(
            ".simulate",
            "simulate many runs of a net or plan, with confidence intervals",
            "simulate my_patrol --time 600 --replications 100",
        ),
        "sweep": Verb(
            ".sweep",
            "measure a net or plan for many teams, rates, durations or policies at once",
            "sweep my_patrol --vary robots=1..5 --time 600",
        ),
        "plot": Verb(
            ".plot",
            "plot results of the analysis: tokens over time, distributions, throughput",
            "plot net.xml -o tokens.svg",
        ),
        "optimise": Verb(
            ".optimise",
            "compute the best policy of a plan for an aim, with certified bounds",
            "optimise my_patrol --reward arrive=1 -o better.json",
        ),
        "fit": Verb(
            ".fit",
            "learn durations, outcomes and failures from the logs of runs",
            "fit my_patrol run.jsonl -o learned.json",
        ),
        "improve": Verb(
            ".improve",
            "learn from logs, compute a better policy for the learned plan, and report its gain",
            "improve my_patrol run.jsonl --reward arrive=1 -o better.json",
        ),
        "compare": Verb(
            ".compare",
            "compare runs with the prediction of their plan: intervals, and an alarm per place",
            "compare learned.json run.jsonl",
        ),
    },
    "run it": {
        "run": Verb(
            ".run",
            "execute a plan without ROS, its agents on threads",
            "run my_patrol --seconds 5 --log run.jsonl",
        ),
        "serve": Verb(
            ".serve",
            "open the page: simulate, analyse and execute the nets and plans of a folder",
            "serve my_patrol --edit",
        ),
        "demo": Verb(
            ".demo",
            "run a plan on a team of robots (needs ROS and a master), and show what happens",
            "demo --plan my_patrol --robots 3",
        ),
        "agent": Verb(
            ".agent",
            "run one robot of a team, without ROS",
            "agent my_patrol --robot robot_1 --connect tcp/HOST:7447",
        ),
        "router": Verb(
            ".router",
            "forward messages between robots without a common ROS master",
            "router --listen tcp/0.0.0.0:7447",
        ),
        "keys": Verb(
            ".keys", "create, show and revoke the certificates of a team", "keys show team_keys"
        ),
    },
    "look back": {
        "replay": Verb(
            ".replay",
            "open the page on a recorded run: an event log, or a rosbag of fired_transitions",
            "replay run.jsonl",
        ),
        "report": Verb(
            ".report",
            "report the story of a recorded run: who waited for whom, and why",
            "report run.jsonl -o report.html",
        ),
        "verify": Verb(
            ".verify",
            "check the logs of a run against the rules, from the logs alone",
            "verify run.jsonl",
        ),
        "history": Verb(
            ".history",
            "keep months of a fleet's logs as tables, and report on them",
            "history report --store fleet",
        ),
        "export": Verb(
            ".export",
            "write recorded runs for other tools: as a rosbag, an MCAP file or a table",
            "export run.jsonl --csv run.csv",
        ),
        "room": Verb(
            ".room",
            "make a room for simulated robots from a map or a Gazebo world",
            "room map.yaml -o room.yaml",
        ),
        "film": Verb(
            ".film",
            "film robots in a room, without a display: a recorded run, or a patrol simulated for "
            "it",
            "film patrol.mp4 --robots 4",
        ),
        "mcp": Verb(
            ".mcp",
            "serve the plans of a folder to language models: check, analyse, draft",
            "mcp my_plans",
        ),
    },
    "this command": {
        "completion": Verb(
            ".completion",
            "print the completion script for bash or zsh",
            "completion bash",
        ),
        "man": Verb(".man", "print a manual page with all verbs and options", "man"),
    },
    OPERATE: {
        "deploy": Verb(
            ".deploy",
            "deploy another plan to a running team without stopping it",
            "deploy better.json",
        ),
    },
}
"""Purpose -> verb -> its module; orders to a team are added to the last purpose."""

VERBS: Dict[str, Verb] = {
    name: verb for verbs in VERB_GROUPS.values() for name, verb in verbs.items()
}
"""Verb -> its module."""


def all_verbs() -> Dict[str, Union[Verb, OrderVerb]]:
    """Verb -> its module or order."""
    from gspn_framework_package.cli.orders import order_verbs

    return {**VERBS, **order_verbs()}


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run one command line and return its exit code; exceptions of a verb do not propagate.

    :param arguments: the words after the program's name; by default those of this process.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is None:
        # Before NumPy is imported. Sparse solvers hand BLAS small blocks, for which its threads
        # cost more than they gain: five times the time of a direct solution.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if isinstance(sys.stdout, io.TextIOWrapper) and hasattr(sys.stdout, "reconfigure"):
        # a file name may have bytes that are not text
        sys.stdout.reconfigure(errors="backslashreplace")
    debug = "--debug" in words or bool(os.environ.get("GSPN_DEBUG"))
    # an interrupt of the libraries' cleanup at exit would print a traceback
    interrupts = Interrupts(signal.SIG_DFL if arguments is None else signal.default_int_handler)
    try:
        with interrupts:
            code = _run(words, interrupts)
        sys.stdout.flush()  # flushed here to notice if the reader has exited
        return code
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        # The reader (head, less) has exited. Python flushes again at exit, which would print an
        # error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except Exception as error:
        if interrupts.seen and isinstance(error, ImportError):
            return _interrupted()
        if debug:
            traceback.print_exc()
        try:
            sys.stdout.flush()
        except OSError:  # Python flushes again at exit, which would print an error
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        message, code = _explain(error)
        print(
            "gspn: %s" % message.encode("utf-8", "backslashreplace").decode("utf-8"),
            file=sys.stderr,
        )
        return code


def _interrupted() -> int:
    print(INTERRUPTED_MESSAGE, file=sys.stderr)
    return EXIT_INTERRUPTED


def _run(words: Sequence[str], interrupts: Interrupts) -> int:
    try:
        args, unknown = _parser(words).parse_known_args(words)
        if unknown:
            args.parser.error(
                "unrecognized arguments: %s%s" % (" ".join(unknown), _meant(args.parser, unknown))
            )
    except SystemExit as leaving:  # --help, --version or wrong usage, which argparse reported
        return leaving.code if isinstance(leaving.code, int) else EXIT_USAGE
    interrupts.verb_has_begun = True
    allow_modules(getattr(args, "modules", ()))
    return int(args.run(args))


def _meant(parser: argparse.ArgumentParser, unknown: Sequence[str]) -> str:
    """The options that were probably meant, for an error message; "" if none is similar."""
    known = [text for action in parser._actions for text in action.option_strings]
    options = (word.partition("=")[0] for word in unknown if word.startswith("--"))
    close = [found for word in options for found in difflib.get_close_matches(word, known, 1)]
    return " (did you mean %s?)" % " or ".join(close) if close else ""


def _explain(error: Exception) -> Tuple[str, int]:
    """Return the message for the user about ``error``, and the exit code."""
    if isinstance(error, GspnError):
        return f"error: {error}", error.exit_code
    if (
        isinstance(error, ModuleNotFoundError)
        and error.name
        and not error.name.startswith(__package__.split(".")[0])
    ):
        return f"error: {missing_library(error)}", EXIT_USAGE
    if isinstance(error, OSError) and error.filename is not None:
        return f"error: {os.fsdecode(error.filename)}: {error.strerror}", EXIT_USAGE
    if isinstance(error, OSError) and error.errno in _DISK:
        return f"error: cannot write: {error.strerror}", EXIT_USAGE
    return (
        f"internal error: {type(error).__name__}: {error}\n"
        "This is a bug in gspn, not an error in its input; run it with --debug to print a "
        "traceback for a bug report.",
        EXIT_INTERNAL,
    )


class _Parser(argparse.ArgumentParser):
    """A parser whose error messages look like all others of this program."""

    def error(self, message: str) -> NoReturn:
        """Print the usage and ``message``, and exit with 2."""
        unknown = re.match(r"argument VERB: invalid choice: '(.*)' \(choose", message)
        if unknown:
            close = difflib.get_close_matches(unknown.group(1), list(all_verbs()), 2)
            hint = (
                "did you mean %s?" % " or ".join(close) if close else "gspn --help lists the verbs"
            )
            self.exit(EXIT_USAGE, f"gspn: error: there is no verb '{unknown.group(1)}' ({hint})\n")
        self.print_usage(sys.stderr)
        self.exit(EXIT_USAGE, f"gspn: error: {message}\n")


def _parser(words: Sequence[str]) -> _Parser:
    """Return the parser for ``words``; it is complete only for the verb that they name."""
    known = VERBS if words and words[0] in VERBS else all_verbs()
    common = _Parser(add_help=False)
    common.add_argument(
        "--debug",
        action="store_true",
        default=argparse.SUPPRESS,
        help="print a traceback with every error (or set GSPN_DEBUG=1)",
    )
    parser = _Parser(
        prog="gspn",
        usage="gspn [-h] [--debug] [--version] VERB ...",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Executes, simulates and analyses Generalized Stochastic Petri Net plans.\n\n"
        + _verbs_text(known),
        epilog="Exit codes: 0 success or yes, 1 plan refused or answer no, 2 wrong input or usage. "
        "'gspn VERB --help' explains a verb.",
        parents=[common],
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"gspn {__version__}")
    verbs = parser.add_subparsers(
        prog="gspn", metavar="VERB", dest="verb", required=True, help=argparse.SUPPRESS
    )
    asked = next((word for word in words if not word.startswith("-")), None)
    for name, entry in known.items():
        verb = verbs.add_parser(name, parents=[common], allow_abbrev=False)
        if name == asked:
            _complete(verb, entry)
    return parser


def _complete(parser: argparse.ArgumentParser, entry: Union[Verb, OrderVerb]) -> None:
    """Declare the arguments of a verb on its parser."""
    parser.description = entry.help
    loaded = entry.load()
    if hasattr(loaded, "add_arguments"):
        loaded.add_arguments(parser)
    else:
        add_options(parser, loaded.OPTIONS)
        parser.epilog = getattr(loaded, "EPILOG", None)
    if entry.example:
        parser.epilog = "%s Example: gspn %s" % (parser.epilog or "", entry.example)
    parser.set_defaults(run=loaded.run, parser=parser)


def parsers() -> Dict[str, argparse.ArgumentParser]:
    """Verb -> its parser, of all verbs."""
    return {name: verb_parser(name) for name in all_verbs()}


def verb_parser(name: str) -> argparse.ArgumentParser:
    """The parser of a verb."""
    parser = _Parser(prog="gspn " + name, allow_abbrev=False)
    _complete(parser, all_verbs()[name])
    return parser


def _verbs_text(known: Mapping[str, Union[Verb, OrderVerb]]) -> str:
    """The verbs by purpose, a line or two each."""
    lines = []
    grouped = {name for verbs in VERB_GROUPS.values() for name in verbs}
    orders = {name: verb for name, verb in known.items() if name not in VERBS}
    others = {name: verb for name, verb in VERBS.items() if name not in grouped}
    groups: Dict[str, Mapping[str, Union[Verb, OrderVerb]]] = {**VERB_GROUPS}
    groups[OPERATE] = {**orders, **VERB_GROUPS[OPERATE]}
    if others:
        groups["others"] = others
    for title, verbs in groups.items():
        lines.append("%s:" % title)
        for name, verb in verbs.items():
            text = textwrap.wrap(verb.help, 64)
            lines += ["  %-12s %s" % pair for pair in zip([name] + [""] * len(text), text)]
        lines.append("")
    return "\n".join(lines).rstrip()
