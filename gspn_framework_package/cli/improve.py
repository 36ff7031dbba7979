"""``gspn improve``: learns from the logs of runs, computes the best policy for what was learned,
and says what it would gain and what stays proven."""

from __future__ import annotations

import argparse
import html
import json
import os
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence

from gspn_framework_package.analysis.decisions.report import Report
from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.preflight.report import CheckItem, Severity
from gspn_framework_package.cli.compare import LogComparison, compare_logs, comparison_text
from gspn_framework_package.cli.fit import Learned, durations_option, fit_table, learn, source_text
from gspn_framework_package.cli.limits import ON_OPTION
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.optimise import (
    add_request_arguments,
    optimised,
    request_in_arguments,
)
from gspn_framework_package.cli.options import Argument, Arguments, add_options
from gspn_framework_package.cli.plan_output import plan_path, refuse_existing, write_plan
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.formats.plan_file import plan_document, read_plan
from gspn_framework_package.formats.source import write_bytes
from gspn_framework_package.model.plan import Plan

_OPTIONS: Arguments = {
    Argument("plan", "PLAN"): "a plan file, or a folder with a plan.json",
    Argument("logs", "LOG", nargs="+"): "event logs of runs of the plan, or folders of them",
    Argument("-o --output", "NEW_PLAN"): (
        "the plan with the learned parameters and the computed policy: a new .json file, or a "
        "folder; by default nothing is written"
    ),
    Argument("--report", "FILE.html"): "write a report to send, as one file",
    "--force": "overwrite NEW_PLAN and FILE.html if they exist",
    "--json": "print the report as one JSON object",
    **ON_OPTION,
}


class _Section(NamedTuple):
    """A part of the report: its title, and its lines of text."""

    title: str
    lines: Sequence[str]


class _Improvement(NamedTuple):
    """What was learned, what the logs say about it, what was computed for it, and the findings of
    the check of the plan as it is, and with the computed policy."""

    learned: Learned
    comparison: LogComparison
    report: Report
    before: Sequence[CheckItem]
    after: Sequence[CheckItem]

    @property
    def new_doubts(self) -> List[str]:
        """The findings for the new plan that the old plan did not have."""
        known = {item.text for item in self.before}
        return [i.text for i in self.after if i.severity is not Severity.OK and i.text not in known]

    def to_json(self) -> Dict[str, Any]:
        """As plain JSON values."""
        return {
            "learned": self.learned.report.to_json(),
            "comparison": self.comparison.to_json(),
            "policy": self.report.to_json(),
            "check": [
                {"check": i.check, "severity": i.severity.value, "text": i.text} for i in self.after
            ],
            "new_doubts": self.new_doubts,
        }

    def sections(self) -> Iterator[_Section]:
        """The report as text."""
        learned = self.learned
        yield _Section(
            "Learned from " + source_text(learned),
            [*fit_table(learned.report), *("note: " + note for note in learned.report.notes)],
        )
        yield _Section(
            "The runs compared with the learned model", list(comparison_text(self.comparison))
        )
        yield _Section("The computed policy", self.report.lines())
        yield _Section(
            "Findings of the check",
            ["%-8s %s" % (item.severity.value, item.text) for item in self.after],
        )

    @property
    def verdict(self) -> str:
        """The result in a sentence."""
        found = self.report
        if found.teams[0].value is None:
            return "no policy was found: %s" % found.teams[0].why
        gain = found.gain
        text = "the gain is not known" if gain is None else "it would gain %+.2f %%" % (100 * gain)
        if found.simulation is not None:
            text += "; simulated as it runs: %s" % found.simulation["text"]
        if self.comparison.departs:
            text += "; the runs differ from what was learned, so expect less"
        doubts = self.new_doubts
        if doubts:
            text += "; the check has new warnings: %s" % "; ".join(doubts)
        return text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    add_options(parser, {**_OPTIONS, **durations_option()})
    add_request_arguments(parser)
    parser.epilog = (
        "Exit codes: 0 there is an answer, 1 there is none, or the check refuses the new plan, 2 "
        "wrong input or wrong usage."
    )


def run(args: argparse.Namespace) -> int:
    """Learn, compute, check; write the plan and the report, and print what was found."""
    plan = read_plan(args.plan)
    request = request_in_arguments(args, len(plan.robots))
    request.resolved(plan.net)  # report errors before reading or computing anything
    path: Optional[str] = None if args.output is None else plan_path(args.output)
    for name in filter(None, (path, args.report)):
        if not args.force:
            refuse_existing(name, "give the name of a new file, or --force")
    learned = learn(plan, args.logs, args.durations, args.seed, args.on)
    fitted = learned.report.apply(plan, learned.logs)
    with ProgressLine() as progress:
        comparison = compare_logs(fitted, args.logs, seed=args.seed, progress=progress)
    report = optimised(fitted, request, args)
    with ProgressLine() as progress:
        before = check(fitted, progress=progress).items
        after = check(report.plan, progress=progress)
    found = _Improvement(learned, comparison, report, before, after.items)
    notes: List[str] = []
    try:
        if path is not None and not after.refused:
            data = plan_document(args.plan, report.plan, os.path.dirname(os.path.abspath(path)))
            notes = write_plan(report.plan, data, args.output)
        if args.report is not None:
            write_bytes(args.report, _page(plan, found).encode())
    finally:  # the answer is printed even if it cannot be written
        _print(found, notes, args.json)
    code = max((failure.exit_code for failure in report.failures), default=0)
    return code or int(after.refused)


def _print(found: _Improvement, notes: List[str], as_json: bool) -> None:
    if as_json:
        print(json.dumps({**found.to_json(), "notes": notes}, indent=2, ensure_ascii=False))
        return
    for section in found.sections():
        print("== %s" % section.title)
        print("\n".join(section.lines))
        print()
    print(found.verdict)
    print_notes(notes)


_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;"
    "color:#1c2430;background:#fff}pre{overflow-x:auto;background:#f3f5f8;padding:1rem;"
    "border-radius:6px;font-size:13px}.verdict{font-size:1.15rem;border-left:4px solid #2b6cb0;"
    "padding-left:1rem}@media(prefers-color-scheme:dark){body{color:#e6eaf0;background:#14181f}"
    "pre{background:#1e242e}}"
)


def _page(plan: Plan, found: _Improvement) -> str:
    """The report as one HTML file."""
    title = html.escape("Improving %s" % plan.name)
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>%s</title>" % title,
        "<style>%s</style><h1>%s</h1>" % (_STYLE, title),
        "<p class='verdict'>%s.</p>" % html.escape(_capital(found.verdict)),
    ]
    for section in found.sections():
        parts.append("<h2>%s</h2>" % html.escape(section.title))
        parts.append("<pre>%s</pre>" % html.escape("\n".join(section.lines)))
    return "\n".join(parts) + "\n"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
