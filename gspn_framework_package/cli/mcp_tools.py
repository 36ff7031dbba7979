"""The tools of ``gspn mcp``. Each runs a ``gspn`` command line in a separate process, which is
ended when it takes too long or is cancelled."""

from __future__ import annotations

import argparse
import functools
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Tuple

import jsonschema

from gspn_framework_package.cli import numbers
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
from gspn_framework_package.visualizer.schemas import (
    FLAG,
    NAMES,
    NUMBER,
    OBJECT,
    OBJECTS,
    TEXT,
    WHOLE,
    Schema,
    described_as,
    list_with,
    map_to,
    object_with,
    or_null,
)

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


_LENGTH: Json = {"minLength": 1, "maxLength": 2000}
"""Of a text."""
_TEXT: Json = {"type": "string", **_LENGTH}

_PLAN = described_as(_TEXT, "path of a plan's folder or file, or of a net, as list_plans gives it")
_OUTPUT = described_as(
    _TEXT, "path of a new file or folder to write; needs a server with --allow-write"
)
_MAY_WAIT = {
    "type": "number",
    "minimum": 0.1,
    "description": "maximum time until the answer in seconds; parts that take longer are left out",
}

_INPUT = ("from", "net", "const", "servers", "controllable")
_AIM = ("reward", "mean-time-to", "cost-to", "reach", "discount", "minimise")
_EFFORT = ("limit", "limit-tree", "limit-structure")

OTHER_NAMES = {"may-wait": "may_wait_in"}
"""Option -> its name as a field, where the two differ: ``may_wait`` is the time of a call."""

_MARKING = map_to({"type": "integer"})
_FINDING = {"check": TEXT, "severity": TEXT, "text": TEXT}
_DECIDED = {
    "kind": TEXT,
    "about": TEXT,
    "verdict": described_as(TEXT, "proven, violated or undecided"),
    "decided_by": TEXT,
    "sequence?": {"type": ["array", "null"], "items": TEXT},
    "marking?": or_null(_MARKING),
}
_CHECK: Dict[str, Schema] = {
    "plan?": TEXT,
    "accepted?": described_as(FLAG, "whether the plan may run"),
    "verdict?": TEXT,
    "states?": {"type": ["integer", "null"]},
    "complete?": FLAG,
    "items?": list_with(_FINDING),
    "answers?": list_with(_DECIDED),
}
_INTERVALS = map_to({"type": ["object", "null"]})


class _Tool(NamedTuple):
    """A tool.

    :ivar options: the options of its verb that can be given, without dashes; with their help.
    :ivar fields: other things that can be given, as JSON schemas.
    :ivar answer: the fields of the answer, with a question mark if they may be missing.
    """

    about: str
    verb: str = ""
    options: Tuple[str, ...] = ()
    fields: Json = {}
    required: Tuple[str, ...] = ("plan",)
    answer: Mapping[str, Schema] = {}
    writes: bool = False


TOOLS = {
    "list_plans": _Tool(
        "List the plans, nets and recorded runs of the folder.",
        required=(),
        answer={
            "files": list_with(
                {"path": TEXT, "kind": described_as(TEXT, "plan, net or log"), "size": WHOLE}
            )
        },
    ),
    "check": _Tool(
        "Check whether a plan may run: structure, dead markings, policy, functions; decide what is "
        "asked about all markings, also of a net. Findings and answers may have a firing sequence, "
        "which explain_witness plays.",
        "check",
        (
            "robots",
            "standalone",
            "limit",
            "seconds",
            "never",
            "always",
            "apart",
            "at-most",
            "never-fires",
            "returns",
            "ends",
            "moves",
        ),
        {"plan": _PLAN},
        answer=_CHECK,
    ),
    "analyse": _Tool(
        "Analyse a net, or a plan under its policy: invariants, bounds, deadlocks, state space, "
        "steady state, throughputs, and answers to questions.",
        "analyse",
        (
            *("robots", "only-net", "rates", "timing", *_INPUT),
            *("query", "at", "reach", "cover", "mean-time-to", "reward", "time-to-steady-state"),
            *("no-structure", "no-time", *_EFFORT, "engine", "symbolic", "lump", "phases"),
        ),
        {"plan": _PLAN, "may_wait": _MAY_WAIT},
        answer={
            "name": TEXT,
            "kind": TEXT,
            "places?": WHOLE,
            "transitions?": WHOLE,
            "states?": or_null(OBJECT),
            "bounded?": or_null(FLAG),
            "bounds?": or_null(OBJECT),
            "deadlocks?": or_null(OBJECT),
            "live?": or_null(FLAG),
            "reach?": OBJECTS,
            "cover?": OBJECTS,
            "steady_state?": or_null(OBJECT),
            "intervals?": described_as(OBJECT, "what answers about time may be"),
            "interval_sources?": NAMES,
            "queries?": OBJECTS,
            "undecided?": described_as(map_to(TEXT), "what could not be decided -> why"),
            "notes?": NAMES,
        },
    ),
    "simulate": _Tool(
        "Simulate many runs of a net or plan: throughputs and mean tokens with confidence "
        "intervals; or, with against, an old plan and a new one, for an aim.",
        "simulate",
        (
            *("robots", "only-net", "rates", "timing", *_INPUT),
            *("time", "until", "warmup", "replications", "precision", "measure", "confidence"),
            *("batches", "losses", "seed", "seconds", *_AIM),
        ),
        {
            "plan": _PLAN,
            "against": described_as(_TEXT, "path of the new plan to compare with"),
            "may_wait": _MAY_WAIT,
        },
        answer={
            "replications?": WHOLE,
            "throughput?": _INTERVALS,
            "mean_tokens?": _INTERVALS,
            "end_time?": or_null(OBJECT),
            "time_to_condition?": or_null(OBJECT),
            "old?": OBJECT,
            "new?": OBJECT,
            "better?": or_null(TEXT),
            "text?": TEXT,
            "notes": NAMES,
        },
    ),
    "optimise": _Tool(
        "Compute the best policy of a plan, or of a net of decisions, for one aim (reward, "
        "mean_time_to, cost_to or reach), with certified bounds.",
        "optimise",
        (
            *("robots", *_AIM, "never", "at-least", "may-wait", "timing", "rates", "uncertain"),
            *("team-sizes", "width", "engine", "simulate", "seed", *_INPUT, *_EFFORT),
        ),
        {"plan": _PLAN, "may_wait": _MAY_WAIT, "output": _OUTPUT},
        answer={
            "objective": OBJECT,
            "value": or_null(NUMBER),
            "lower": or_null(NUMBER),
            "upper": or_null(NUMBER),
            "present_policy": OBJECT,
            "gain": or_null(NUMBER),
            "teams": OBJECTS,
            "constraints": OBJECTS,
            "choices": OBJECTS,
            "storm?": or_null(NUMBER),
            "simulation?": or_null(OBJECT),
            "plan?": or_null(OBJECT),
            "notes?": NAMES,
        },
        writes=True,
    ),
    "explain_witness": _Tool(
        "Play a firing sequence step by step, with the marking after each firing and why one "
        "cannot fire; by default the sequences behind the findings of check. With run_net: what "
        "the nodes of the run net stand for.",
        "explain",
        ("robots", "limit", "run-net", "timing", "phases"),
        {
            "plan": _PLAN,
            "transitions": {
                "type": "array",
                "items": _TEXT,
                "maxItems": 200,
                "description": "the transitions to fire, in order",
            },
        },
        answer={
            "plan": TEXT,
            "sequences?": list_with(
                {"text": TEXT, "start": _MARKING, "steps": OBJECTS, "stopped_by": TEXT}
            ),
            "places?": OBJECT,
            "transitions?": OBJECT,
        },
    ),
    "draft_plan": _Tool(
        "Draft a plan and check it: from a template (%s), or as a complete document including its "
        "net (keys net, actions, policy, robots; docs/plan_file.md). Returns the files and the "
        "result of the check." % ", ".join(templates.templates_by_name()),
        "new",
        ("robots", "places"),
        {
            "template": {"enum": list(templates.templates_by_name())},
            "document": {"type": "object", "description": "the plan, instead of a template"},
            "output": _OUTPUT,
        },
        (),
        answer={
            "written_to": or_null(TEXT),
            "check": object_with(_CHECK),
            "files": map_to(TEXT),
        },
        writes=True,
    ),
}

WITHHELD = {
    **dict.fromkeys(("help", "debug", "json"), "of the command line only"),
    **dict.fromkeys(("csv", "log", "certificate", "output", "force"), "writes files"),
    **dict.fromkeys(("memory", "scratch"), "fills the disk"),
    **dict.fromkeys(("on", "modules"), "whoever starts the server decides where to compute"),
    **dict.fromkeys(("limit-time", "limit-memory"), "limits of the server"),
    "against": "a path: a separate field",
    **dict.fromkeys(("example", "list"), "resources and list_plans have it"),
}
"""Option of a verb -> why it cannot be given to a tool."""


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
                "outputSchema": object_with(tool.answer),
                "annotations": {
                    "readOnlyHint": not (tool.writes and self._writes),
                    "destructiveHint": False,
                    "openWorldHint": False,
                },
            }
            for name, tool in TOOLS.items()
        ]

    def call(self, name: str, arguments: Mapping[str, Any], tick: ProgressTick) -> str:
        """Answer one call with a JSON object, as text.

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
            return self._short(
                json.dumps({"files": [entry._asdict() for entry in self._folder.entries()]})
            )
        output = self._output(fields.pop("output", None))
        seconds = min(fields.pop("may_wait", math.inf), self._limits.seconds)
        run = _Runs(self._folder.root, self._limits._replace(seconds=seconds), tick)
        if name == "draft_plan":
            return self._short(self._draft(fields, output, run))
        named = ["--", self._path(fields.pop("plan")), *fields.pop("transitions", [])]
        words = [tool.verb, "--json"]
        if "against" in fields:
            words.append("--against=" + self._path(fields.pop("against")))
        if name == "check":
            words += _modules()
        if name in ("analyse", "optimise"):  # which return partial results when a part takes long
            words.append("--limit-time=%g" % (seconds / PARTS))
        if output:
            words.append("--output=" + output)
        return self._short(run.run([*words, *_options(fields), *named]))

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

    def _short(self, text: str) -> str:
        """The answer. :raises LimitError: it is too long."""
        most = self._limits.characters
        if len(text) > most:
            raise LimitError(
                "the answer has %d characters, of which these are the first %d:\n%s\n"
                % (len(text), most, text[:most]),
                hint="ask for less, or start the server with a higher --limit-output",
            )
        return text


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
            reported = err.read(10_000).decode("utf-8", "replace").strip()
        raise InputError(reported.split("error: ", 1)[-1] or "no answer (%d)" % child.returncode)

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


@functools.lru_cache(maxsize=None)
def _options_of(verb: str) -> Mapping[str, argparse.Action]:
    """The options of a verb: name without dashes -> the option."""
    from gspn_framework_package.cli.main import verb_parser  # it loads this module

    actions = verb_parser(verb)._actions
    return {a.option_strings[-1][2:]: a for a in actions if a.option_strings}


def _field_name(option: str) -> str:
    return OTHER_NAMES.get(option, option.replace("-", "_"))


def _option_schema(option: argparse.Action) -> Schema:
    """The schema of an option's value, with its help."""
    read = option.type
    schema: Schema = dict(_TEXT)
    if option.nargs == 0:
        schema = FLAG
    elif option.choices is not None:
        schema = {"enum": list(option.choices)}
    elif isinstance(read, numbers.WholeNumbers):
        schema = {"type": "integer", "minimum": read.least, "maximum": read.most}
    elif isinstance(read, numbers.RealNumbers) or read is float:
        schema = NUMBER
    if isinstance(option.default, list) or option.nargs == "+":
        schema = {"type": ["array", schema["type"]], "items": schema, "maxItems": 200, **_LENGTH}
    return described_as(schema, (option.help or "") % {"default": option.default})


def _schema(tool: _Tool) -> Json:
    options = _options_of(tool.verb) if tool.options else {}
    given = {_field_name(name): _option_schema(options[name]) for name in tool.options}
    return {
        "type": "object",
        "properties": {**tool.fields, **given},
        "required": list(tool.required),
        "additionalProperties": False,
    }


def _modules() -> List[str]:
    """The modules allowed at the start of this server."""
    return ["--modules=" + ",".join(allowed_modules())] if allowed_modules() else []


def _options(fields: Mapping[str, Any]) -> List[str]:
    """Format the options of a command line so that their values cannot be mistaken for options."""
    words: List[str] = []
    options = {field: option for option, field in OTHER_NAMES.items()}
    for name, value in fields.items():
        option = "--" + options.get(name, name.replace("_", "-"))
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
