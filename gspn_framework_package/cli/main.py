"""The dispatcher of the command line: finds the module of the requested verb and runs it.

A verb is a module with ``add_arguments(parser)`` and ``run(args) -> int``, and a row of
:data:`VERBS`. Only the module of the requested verb is imported, so that ``gspn --help`` and the
light verbs start at once.

Exit codes: 0 the answer is yes, 1 the answer is no or a plan was refused, 2 the input or the usage
is wrong, 70 internal error, 130 interrupted, 141 the reader of the output has exited.
"""

from __future__ import annotations

import argparse
import errno
import importlib
import io
import os
import signal
import sys
import traceback
from typing import Any, Dict, NamedTuple, NoReturn, Optional, Sequence, Tuple, Union

from gspn_framework_package import __version__
from gspn_framework_package.cli.interrupts import EXIT_INTERRUPTED, INTERRUPTED, Interrupts
from gspn_framework_package.cli.orders import ORDERS, OrderVerb
from gspn_framework_package.execution.plan_modules import allow_modules
from gspn_framework_package.model.errors import GspnError, missing_library

EXIT_USAGE = 2
EXIT_INTERNAL = 70  # EX_SOFTWARE of sysexits.h
EXIT_BROKEN_PIPE = 141  # 128 + SIGPIPE

_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""What a disk that is full or broken says."""


class Verb(NamedTuple):
    """A verb with its own module.

    :ivar module: the full name of the module or, with a leading dot, its name in this package.
    :ivar help: what the verb does, in one line.
    """

    module: str
    help: str

    def load(self) -> Any:
        """Import and return the module, which declares the verb's arguments and runs it."""
        return importlib.import_module(self.module, __package__)


VERBS: Dict[str, Union[Verb, OrderVerb]] = {
    "new": Verb(".new", "write a plan to begin with: patrol, inspect, deliver, charge, rendezvous"),
    "build": Verb(".build", "make a plan from a topological map and the tasks there"),
    "check": Verb(".check", "check whether a plan may run, before any robot moves"),
    "run": Verb(".run", "execute a plan without ROS, its agents on threads"),
    "simulate": Verb(".simulate", "simulate many runs of a net or plan, with confidence intervals"),
    "sweep": Verb(
        ".sweep", "measure a net or plan for many teams, rates, durations or policies at once"
    ),
    "analyse": Verb(
        ".analyse", "analyse a net, or a plan under its policy: structure, state space, time"
    ),
    "plot": Verb(
        ".plot", "plot results of the analysis: tokens over time, distributions, throughput"
    ),
    "draw": Verb(".draw", "draw a net, its coverability tree or its Markov chain"),
    "convert": Verb(".convert", "write a net in another format, or a plan as one file"),
    "diff": Verb(".diff", "compare two plans or nets: what was added, removed and changed"),
    "explain": Verb(
        ".explain", "play a firing sequence step by step, such as the one behind a finding of check"
    ),
    "serve": Verb(
        ".serve", "open the page: simulate, analyse and execute the nets and plans of a folder"
    ),
    "replay": Verb(
        ".replay", "open the page on a recorded run: an event log, or a rosbag of fired_transitions"
    ),
    "export": Verb(
        ".export", "write recorded runs for other tools: as a rosbag, an MCAP file or a table"
    ),
    "mcp": Verb(".mcp", "serve the plans of a folder to language models: check, analyse, draft"),
    "compare": Verb(
        ".compare", "compare runs with what their plan predicts: intervals, and an alarm per place"
    ),
    "verify": Verb(".verify", "check the logs of a run against the rules, from the logs alone"),
    "history": Verb(".history", "keep months of a fleet's logs as tables, and report on them"),
    "fit": Verb(".fit", "learn durations, outcomes and failures from the logs of runs"),
    "optimise": Verb(
        ".optimise", "compute the best policy of a plan for an aim, with certified bounds"
    ),
    "film": Verb(
        ".film",
        "film robots in a room, without a display: a recorded run, or a patrol simulated for it",
    ),
    "demo": Verb(
        ".demo", "run a plan on a team of robots (needs ROS and a master), and show what happens"
    ),
    "agent": Verb(".agent", "be one robot of a team, without ROS"),
    "keys": Verb(".keys", "make, show and revoke the certificates of a team"),
    "router": Verb(".router", "pass messages on between robots that have no ROS master in common"),
    "status": Verb(".status", "show what every robot of a running team does and waits for"),
    "breakpoints": Verb(".breakpoints", "halt a robot at a place or a transition, for debugging"),
    "deploy": Verb(".deploy", "put another plan into a running team, without stopping it"),
    "submit": Verb(".submit", "give a task to a running team"),
    "trust": Verb(".trust", "go on without the robots that stay off after a loss of power"),
    **ORDERS,
}
"""Verb -> its module or order, in the order in which a new user needs them."""


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run one command line and return its exit code; exceptions of a verb do not propagate.

    :param arguments: the words after the program's name; by default those of this process.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if isinstance(sys.stdout, io.TextIOWrapper) and hasattr(sys.stdout, "reconfigure"):
        # a file name may have bytes that are not text
        sys.stdout.reconfigure(errors="backslashreplace")
    debug = "--debug" in words or bool(os.environ.get("GSPN_DEBUG"))
    # an interrupt of what libraries do when Python exits would print a traceback
    interrupts = Interrupts(signal.SIG_DFL if arguments is None else signal.default_int_handler)
    try:
        with interrupts:
            code = _run(words, interrupts)
        sys.stdout.flush()  # here, to notice if the reader has exited
        return code
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        # The reader (head, less) has exited. Python flushes again at exit, and would complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except Exception as error:
        if interrupts.seen and isinstance(error, ImportError):
            return _interrupted()
        if debug:
            traceback.print_exc()
        try:
            sys.stdout.flush()
        except OSError:  # Python flushes again at exit, and would complain
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        message, code = _explain(error)
        print(
            "gspn: %s" % message.encode("utf-8", "backslashreplace").decode("utf-8"),
            file=sys.stderr,
        )
        return code


def _interrupted() -> int:
    print(INTERRUPTED, file=sys.stderr)
    return EXIT_INTERRUPTED


def _run(words: Sequence[str], interrupts: Interrupts) -> int:
    try:
        args, unknown = _parser(words).parse_known_args(words)
        if unknown:
            args.parser.error("unrecognized arguments: %s" % " ".join(unknown))
    except SystemExit as leaving:  # --help, --version or wrong usage, which argparse reported
        return leaving.code if isinstance(leaving.code, int) else EXIT_USAGE
    interrupts.verb_has_begun = True
    allow_modules(getattr(args, "modules", ()))
    return int(args.run(args))


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
        "This is a fault of gspn, not of its input; with --debug it prints a traceback to report.",
        EXIT_INTERNAL,
    )


class _Parser(argparse.ArgumentParser):
    """A parser whose errors look like all other errors of this program."""

    def error(self, message: str) -> NoReturn:
        """Print the usage and ``message``, and exit with 2."""
        self.print_usage(sys.stderr)
        self.exit(EXIT_USAGE, f"gspn: error: {message}\n")


def _parser(words: Sequence[str]) -> _Parser:
    """Return the parser for ``words``; it is complete only for the verb that they name."""
    common = _Parser(add_help=False)
    common.add_argument(
        "--debug",
        action="store_true",
        default=argparse.SUPPRESS,
        help="print a traceback with every error (or set GSPN_DEBUG=1)",
    )
    parser = _Parser(
        prog="gspn",
        description="Executes, simulates and analyses Generalized Stochastic Petri Net plans.",
        epilog="Exit codes: 0 yes, 1 the plan or the answer is no, 2 wrong input or usage. "
        "'gspn VERB --help' explains a verb.",
        parents=[common],
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"gspn {__version__}")
    verbs = parser.add_subparsers(title="verbs", metavar="VERB", dest="verb", required=True)
    asked = next((word for word in words if not word.startswith("-")), None)
    for name, entry in VERBS.items():
        verb = verbs.add_parser(name, help=entry.help, parents=[common], allow_abbrev=False)
        if name == asked:
            verb.description = entry.help
            loaded = entry.load()
            loaded.add_arguments(verb)
            verb.set_defaults(run=loaded.run, parser=verb)
    return parser
