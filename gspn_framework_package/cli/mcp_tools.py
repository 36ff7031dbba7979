"""The tools of ``gspn mcp``. Each runs a ``gspn`` command line in a separate process, which is
ended when it takes too long or is cancelled."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Tuple

import jsonschema

from gspn_framework_package.execution.plan_modules import allowed_modules
from gspn_framework_package.formats.json_file import json_text, read_json
from gspn_framework_package.formats.plan_file import PLAN_FILE
from gspn_framework_package.making import templates
from gspn_framework_package.model.errors import (
    CancelledError,
    InputError,
    LimitError,
    RefusedError,
    UsageError,
)
from gspn_framework_package.visualizer.documents import Folder

Json = Dict[str, Any]
ProgressTick = Callable[[float], bool]

TICK = 0.5
"""Seconds between two checks whether a call was cancelled."""

PARTS = 3
"""Time limit of a call, as a multiple of the limit of each part of an analysis."""

PROGRAM = (
    "import json, signal, sys; sys.path[:0] = json.loads(sys.argv.pop(1)); "
    "from gspn_framework_package.execution.parent_death import end_with_parent; "
    "end_with_parent(int(sys.argv.pop(1)), signal.SIGKILL) or sys.exit(1); "
    "from gspn_framework_package.cli.main import main; sys.exit(main())"
)
"""``gspn``, started with ``-I`` so that modules in the plans' folder cannot replace Python's. It
ends with the server, even if the server is killed."""


class CallLimits(NamedTuple):
    """Limits of a call: ``seconds``, and ``characters`` of its answer."""

    seconds: float
    characters: int


def _text(about: str) -> Json:
    return {"type": "string", "description": about, "minLength": 1, "maxLength": 2000}


def _texts(about: str) -> Json:
    return {"type": "array", "items": _text("one of them"), "maxItems": 200, "description": about}


def _whole(about: str, least: int = 1, most: int = 10**6) -> Json:
    return {"type": "integer", "minimum": least, "maximum": most, "description": about}


def _number(about: str, least: float = 0.0) -> Json:
    return {"type": "number", "minimum": least, "maximum": 1e12, "description": about}


def _flag(about: str) -> Json:
    return {"type": "boolean", "description": about}


_PLAN = _text("path of a plan's folder or file, or of a net, as list_plans gives it")
_ROBOTS = _whole("size of the team; by default that of the plan", 1, 10_000)
MAY_WAIT = _number(
    "maximum time until the answer in seconds; parts that take longer are left out", 0.1
)
OUTPUT = _text("path of a new file or folder to write; needs a server with --allow-write")
_CONDITION = "a condition on markings, such as \"p3 >= 1 and 'Check L1' == 0\", or deadlock"

AIMS = {
    "reward": _texts("NAME=R: R per token in a place and second, or per firing of a transition"),
    "mean_time_to": _text("minimise the mean time until this holds:  " + _CONDITION),
    "cost_to": _text("minimise the mean cost until this holds; reward gives the costs"),
    "reach": _text("maximise the probability that this ever holds:  " + _CONDITION),
    "discount": _number("weight rewards at time t by exp(-discount t) (discount in 1/s)"),
    "minimise": _flag("minimise the rewards or the probability instead"),
    "never": _texts("conditions that may never hold"),
    "at_least": _texts("NAME>=X: in the long run a transition fires at least X times a second"),
}

ABOUT_ALL_MARKINGS = {
    "never": _texts("conditions that never hold"),
    "always": _texts("conditions that always hold"),
    "apart": _texts("patterns of places, such as At_*, that never have two tokens each"),
    "at_most": _texts("PATTERN=N: no place that matches ever has more than N tokens"),
    "never_fires": _texts("transitions that never fire"),
    "returns": _texts("conditions that can come to hold, from every marking"),
    "ends": _flag("the plan can end, from every marking"),
    "moves": _flag("every robot that is not at an end can move again, from every marking"),
}


class _Tool(NamedTuple):
    about: str
    fields: Json
    required: Tuple[str, ...] = ("plan",)
    verb: str = ""
    writes: bool = False


TOOLS = {
    "list_plans": _Tool("List the plans, nets and recorded runs of the folder.", {}, ()),
    "check": _Tool(
        "Check whether a plan may run: structure, dead markings, policy, functions; decide what is "
        "asked about all markings, also of a net. Findings and answers may have a firing sequence, "
        "which explain_witness plays.",
        {
            "plan": _PLAN,
            "robots": _ROBOTS,
            "standalone": _flag(
                "check the plan for agents, which transitions may create and destroy"
            ),
            **ABOUT_ALL_MARKINGS,
            "seconds": _number("maximum time for each question in seconds (default 10)"),
        },
        verb="check",
    ),
    "analyse": _Tool(
        "Analyse a net, or a plan under its policy: invariants, bounds, deadlocks, state space, "
        "steady state, throughputs, and answers to questions.",
        {
            "plan": _PLAN,
            "robots": _ROBOTS,
            "only_net": _flag("analyse a plan's net by its weights instead of the policy"),
            "reach": _text("can this be reached: " + _CONDITION),
            "cover": _text("P=N,...: can a marking with at least these tokens be reached"),
            "mean_time_to": _text("mean time until this holds: " + _CONDITION),
            "may_wait": MAY_WAIT,
        },
        verb="analyse",
    ),
    "simulate": _Tool(
        "Simulate many runs of a net or plan: throughputs and mean tokens with confidence "
        "intervals.",
        {
            "plan": _PLAN,
            "time": _number("length of a run in seconds"),
            "replications": _whole("number of runs (default 1000)"),
            "robots": _ROBOTS,
            "until": _text("ends a run: " + _CONDITION),
            "seed": _whole("seed of the random numbers (default 0)", 0, 2**31),
            "may_wait": MAY_WAIT,
        },
        ("plan", "time"),
        verb="simulate",
    ),
    "optimise": _Tool(
        "Compute the best policy of a plan for one aim (reward, mean_time_to, cost_to or reach), "
        "with certified bounds.",
        {"plan": _PLAN, "robots": _ROBOTS, **AIMS, "may_wait": MAY_WAIT, "output": OUTPUT},
        verb="optimise",
        writes=True,
    ),
    "explain_witness": _Tool(
        "Play a firing sequence step by step, with the marking after each firing and why one "
        "cannot fire; by default the sequences behind the findings of check.",
        {
            "plan": _PLAN,
            "robots": _ROBOTS,
            "transitions": _texts("the transitions to fire, in order"),
        },
        verb="explain",
    ),
    "draft_plan": _Tool(
        "Draft a plan and check it: from a template (%s), or as a complete document including its "
        "net (keys net, actions, policy, robots; docs/plan_file.md). Returns the files and the "
        "result of the check." % ", ".join(templates.templates_by_name()),
        {
            "template": {"enum": list(templates.templates_by_name())},
            "robots": _ROBOTS,
            "places": _texts("where the robots go, for templates that take places"),
            "document": {"type": "object", "description": "the plan, instead of a template"},
            "output": OUTPUT,
        },
        (),
        verb="new",
        writes=True,
    ),
}


class PlanTools:
    """The tools for one folder.

    :param folder: the folder of the plans.
    :param allow_write: whether new plans may be written into it.
    :param limits: limits of a call.
    :raises InputError: the folder does not exist.
    """

    instructions = (
        "Robot plans as Petri nets (GSPNs). Begin with list_plans. No tool runs a plan or commands "
        "a robot."
    )

    def __init__(self, folder: str, allow_write: bool, limits: CallLimits) -> None:
        self._folder, self._writes, self._limits = Folder(folder), allow_write, limits

    def listed(self) -> List[Json]:
        """The tools, as the protocol describes them."""
        return [
            {
                "name": name,
                "description": tool.about,
                "inputSchema": _schema(tool),
                "annotations": {
                    "readOnlyHint": not (tool.writes and self._writes),
                    "destructiveHint": False,
                    "openWorldHint": False,
                },
            }
            for name, tool in TOOLS.items()
        ]

    def call(self, name: str, arguments: Mapping[str, Any], tick: ProgressTick) -> str:
        """Answer one call with a text, which is JSON unless it was truncated.

        :param tick: called at intervals with the seconds since the start; returns whether the
            client has cancelled the call.
        :raises GspnError: there is no answer; the message says why.
        """
        tool, fields = TOOLS[name], dict(arguments)
        try:
            jsonschema.validate(fields, _schema(tool))
        except jsonschema.ValidationError as error:
            where = ".".join(str(step) for step in error.absolute_path)
            raise UsageError(error.message[:300], element=where or None) from None
        if name == "list_plans":
            return self._cut(
                json.dumps({"files": [entry._asdict() for entry in self._folder.entries()]})
            )
        output = self._output(fields.pop("output", None))
        seconds = min(fields.pop("may_wait", math.inf), self._limits.seconds)
        run = _Runs(self._folder.root, self._limits._replace(seconds=seconds), tick)
        if name == "draft_plan":
            return self._cut(self._draft(fields, output, run))
        named = ["--", self._path(fields.pop("plan")), *fields.pop("transitions", [])]
        words = [tool.verb, "--json"]
        if name == "check":
            words += _modules()
        if name in (
            "analyse",
            "optimise",
        ):  # these return partial results when a part takes too long
            words.append("--limit-time=%g" % (seconds / PARTS))
        if output:
            words.append("--output=" + output)
        return self._cut(run.run([*words, *_options(fields), *named]))

    def _path(self, path: str) -> str:
        """The path of something to read, for a command line in the folder."""
        whole = self._folder.resolve(path)
        _refuse_outside(self._folder, whole)
        return os.path.join(".", os.path.relpath(whole, self._folder.root))

    def _output(self, path: Any) -> str:
        """The path of something new to write, for a command line in the folder."""
        if path is None:
            return ""
        if not self._writes:
            raise RefusedError("writing is not allowed", hint="gspn mcp --allow-write")
        head, tail = os.path.split(os.path.normpath(path))
        if tail in ("", ".", "..") or tail.startswith("."):
            raise UsageError("'%s' is not the name of a new file or folder" % path)
        folder = self._folder.resolve(head or ".")
        whole = os.path.join(folder, tail)
        if os.path.lexists(whole):
            raise RefusedError("it already exists", file=path, hint="choose another name")
        return os.path.join(".", os.path.relpath(whole, self._folder.root))

    def _draft(self, fields: Json, output: str, run: _Runs) -> str:
        document = fields.pop("document", None)
        if (document is None) == ("template" not in fields):
            raise UsageError("give either a template or a document")
        with tempfile.TemporaryDirectory(prefix="gspn_draft_") as place:
            made = os.path.join(place, os.path.basename(output) or "draft")
            if document is None:
                template = fields.pop("template")
                places = fields.pop("places", [])
                chosen = ["--places", *places] if places else []
                if any(each.startswith("-") for each in places):
                    raise UsageError("the name of a place must not begin with '-'")
                run.run(["new", template, made, *_options(fields), *chosen, "--json"])
            else:
                _check_document(document)
                os.mkdir(made)
                with open(os.path.join(made, PLAN_FILE), "w", encoding="utf-8") as file:
                    file.write(json_text(document))
            report = json.loads(run.run(["check", made, "--json", *_modules()]))
            files = {name: _content(os.path.join(made, name)) for name in sorted(os.listdir(made))}
            if output:
                self._write(output, files)
        return json.dumps(
            {"written_to": output or None, "check": report, "files": files}, ensure_ascii=False
        )

    def _write(self, output: str, files: Mapping[str, str]) -> None:
        whole = os.path.join(self._folder.root, output)
        try:
            os.mkdir(whole)
            for name, text in files.items():
                with open(os.path.join(whole, name), "x", encoding="utf-8") as file:
                    file.write(text)
        except OSError as error:
            raise InputError("cannot be written (%s)" % error.strerror, file=output) from None

    def _cut(self, text: str) -> str:
        most = self._limits.characters
        if len(text) <= most:
            return text
        return "%s\n[cut: the first %d of %d characters]" % (text[:most], most, len(text))


class _Runs:
    """Runs command lines for one call, all within its time."""

    def __init__(self, folder: str, limits: CallLimits, tick: ProgressTick) -> None:
        self._folder, self._limits, self._tick = folder, limits, tick
        self._begun = time.monotonic()

    def run(self, words: List[str]) -> str:
        """Return what a command line prints.

        :raises CancelledError: the client cancelled the call.
        :raises GspnError: the input was wrong, or the command took too long.
        """
        package = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
        paths = [package, *(path for path in sys.path if path and os.path.isdir(path))]
        paths = [p for p in paths if p == package or os.path.realpath(p) != self._folder]
        command = [sys.executable, "-I", "-c", PROGRAM, json.dumps(paths), str(os.getpid())]
        command += words
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
            child = subprocess.Popen(
                command, cwd=self._folder, stdin=subprocess.DEVNULL, stdout=out, stderr=err
            )
            try:
                self._wait(child)
            finally:
                child.kill()
                child.wait()
            out.seek(0)
            err.seek(0)
            if child.returncode in (0, 1) and os.fstat(out.fileno()).st_size:
                return out.read().decode("utf-8", "replace")
            told = err.read(10_000).decode("utf-8", "replace").strip()
        raise InputError(told.split("error: ", 1)[-1] or "no answer (%d)" % child.returncode)

    def _wait(self, child: subprocess.Popen[bytes]) -> None:
        while True:
            try:
                child.wait(TICK)
                return
            except subprocess.TimeoutExpired:
                seconds = time.monotonic() - self._begun
            if self._tick(seconds):
                raise CancelledError("the call was cancelled")
            if seconds > self._limits.seconds:
                raise LimitError(
                    "no answer within %g seconds" % self._limits.seconds,
                    hint="ask for less, or for more seconds: may_wait, gspn mcp --limit-time",
                )


def _schema(tool: _Tool) -> Json:
    return {
        "type": "object",
        "properties": tool.fields,
        "required": list(tool.required),
        "additionalProperties": False,
    }


def _modules() -> List[str]:
    """The modules allowed at the start of this server."""
    return ["--modules=" + ",".join(allowed_modules())] if allowed_modules() else []


def _options(fields: Mapping[str, Any]) -> List[str]:
    """Format the options of a command line so that their values cannot be mistaken for options."""
    words: List[str] = []
    for name, value in fields.items():
        option = "--" + name.replace("_", "-")
        if isinstance(value, bool):
            words += [option] if value else []
        else:
            words += [
                "%s=%s" % (option, v) for v in (value if isinstance(value, list) else [value])
            ]
    return words


def _named_files(plan: Any) -> List[str]:
    """The files named by a plan object."""
    if not isinstance(plan, dict):
        return []
    net, actions = plan.get("net"), plan.get("actions")
    named = [net.get("file") if isinstance(net, dict) else net, plan.get("policy")]
    named += [plan.get("gspn"), plan.get("project_path")]
    if isinstance(actions, dict):
        named += [each.get("plan") for each in actions.values() if isinstance(each, dict)]
    return [name for name in named if isinstance(name, str)]


def _refuse_outside(folder: Folder, whole: str, depth: int = 8) -> None:
    """Check that a plan names no file outside the folder.

    :raises RefusedError: the plan or one of its subnets does.
    """
    if os.path.isdir(whole):
        whole = os.path.join(whole, PLAN_FILE)
    if not whole.endswith(".json") or not os.path.isfile(whole):
        return
    try:
        plan = read_json(whole)
    except InputError:
        return  # the reader reports the error
    for name in _named_files(plan):
        named = os.path.join(os.path.dirname(whole), name)
        if "\0" in name or folder.inside(named) is None:
            raise RefusedError("the plan names '%.200s', which is outside the folder" % name)
        if os.path.exists(named) and depth:
            _refuse_outside(folder, os.path.realpath(named), depth - 1)


def _check_document(document: Json) -> None:
    """Check that a drafted plan is self-contained. :raises UsageError: it names other files."""
    named = _named_files(document)
    if named:
        raise UsageError(
            "a drafted plan must not name files such as '%.200s'" % named[0],
            hint="put the net and the policy into the document",
        )


def _content(path: str) -> str:
    with open(path, encoding="utf-8", errors="replace") as file:
        return file.read()
