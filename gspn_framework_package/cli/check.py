"""``gspn check``: runs the check that precedes every run, and decides questions about all
markings."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any, Dict, List, Union

from gspn_framework_package.analysis.plan.structure import may_lose_robots
from gspn_framework_package.analysis.preflight import MARKING_LIMIT, PROOF_SECONDS
from gspn_framework_package.analysis.preflight.report import PreflightReport, marking_text, sequence
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.options import (
    MODULES_OPTION,
    Argument,
    Arguments,
    repeated,
    value_name,
)
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.formats.plan_file import is_plan, read_net_or_plan, read_plan
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.check_all import check_all

if TYPE_CHECKING:
    from gspn_framework_package.analysis.proofs.ladder import Answer
    from gspn_framework_package.analysis.proofs.questions import MarkingQuestion
    from gspn_framework_package.analysis.watch import Progress

_QUESTIONS: Arguments = {
    repeated("--never", "CONDITION"): (
        "decide whether a condition on the marking, such as 'a >= 2 and b == 0', never holds (this "
        "and the other questions may be repeated)"
    ),
    repeated("--always", "CONDITION"): "decide whether a condition on the marking always holds",
    repeated("--apart", "PATTERN"): (
        "decide whether no place whose name matches, such as 'At_*', ever has two tokens"
    ),
    repeated("--at-most", "PATTERN=N"): (
        "decide whether no place whose name matches ever has more than N tokens"
    ),
    repeated("--never-fires", "TRANSITION"): "decide whether a transition never fires",
    repeated("--returns", "CONDITION"): (
        "decide whether, from every marking, one can be reached in which the condition holds"
    ),
    "--ends": (
        "decide whether a plan can end from every marking: all robots in places without outputs, "
        "or its 'until' holds"
    ),
    "--moves": (
        "decide whether every robot of a plan that is not at an end can move again, from every "
        "marking, so that none waits for ever"
    ),
}

OPTIONS: Arguments = {
    Argument("plan", "PLAN"): (
        "a plan file, or a folder with a plan.json; with questions about all markings, also a net"
    ),
    "--json": "print the report as one JSON object",
    Argument("--limit", "N", numbers.markings, MARKING_LIMIT): (
        "maximum number of markings to visit if structure cannot decide (default %(default)s)"
    ),
    Argument("--robots", "N", numbers.robots): "check the plan for a team of N robots",
    "--standalone": "check the plan for agents; transitions may create and destroy agents",
    Argument("--seconds", "S", numbers.number(0, 1e6), PROOF_SECONDS): (
        "time for each question that visiting markings leaves open, and for each that is asked "
        "(default %(default)g)"
    ),
    **_QUESTIONS,
    Argument("--certificate", "FILE"): (
        "decide also whether a dead marking, or one that needs a policy row and has none, can be "
        "reached, and write the proofs of all that is proven; 'gspn verify FILE' checks them"
    ),
    **MODULES_OPTION,
}

EPILOG = (
    "Exit codes: 0 the plan may run (read the warnings) and everything asked is proven, 1 "
    "refused, or something is not proven, 2 not a plan."
)


def run(args: argparse.Namespace) -> int:
    """Check the plan, decide what is asked, and print the report and the answers."""
    if args.certificate or any(_asked(args).values()):
        return _decide(args)
    plan = _plan(args)
    report = _report(args, plan)
    if args.json:
        print(json.dumps(_as_json(report, plan), indent=2))
    else:
        _print(report, plan)
    return report.exit_code


def _asked(args: argparse.Namespace) -> Dict[str, Any]:
    """The questions about all markings, as :func:`.proofs.questions_about` takes them."""
    return {name: getattr(args, name) for name in map(value_name, _QUESTIONS)}


def _plan(args: argparse.Namespace) -> Plan:
    plan = read_plan(args.plan)
    return plan if args.robots is None else plan.for_robots(args.robots)


def _report(args: argparse.Namespace, plan: Plan) -> PreflightReport:
    with ProgressLine() as progress:
        return check_all(
            plan,
            limit=args.limit,
            standalone=args.standalone,
            seconds=args.seconds,
            progress=progress,
        )


def _as_json(report: PreflightReport, plan: Plan) -> Dict[str, Any]:
    return {**report.to_json(), "notes": list(plan.notes)}


def _print(report: PreflightReport, plan: Plan) -> None:
    for note in plan.notes:
        print("note     %s" % note)
    print(report)


def _decide(args: argparse.Namespace) -> int:
    """Decide the questions that are asked; of a plan, after the check."""
    from gspn_framework_package.cli import proofs

    subject: Union[Net, Plan]
    asked = {**_asked(args), "general": bool(args.certificate)}
    data: Dict[str, Any] = {}
    code = 0
    if is_plan(args.plan):
        subject = _plan(args)
        questions = proofs.questions_about(subject, **asked)
        report = _report(args, subject)
        code = report.exit_code
        data = _as_json(report, subject)
        if not args.json:
            _print(report, subject)
    else:
        subject = read_net_or_plan(args.plan).net
        questions = proofs.questions_about(subject, **asked)
    with ProgressLine() as progress:
        answers = decide_all(
            subject,
            questions,
            seconds=args.seconds,
            limit=args.limit,
            standalone=args.standalone,
            progress=progress,
        )
    data["answers"] = [answer.to_json() for answer in answers]
    if args.json:
        print(json.dumps(data, indent=2))
    else:
        print("\n".join(map(answer_text, answers)))
    if args.certificate:
        found = [
            {"question": answer.question._asdict(), "certificate": answer.certificate}
            for answer in answers
            if answer.certificate is not None
        ]
        proofs.write_proofs(args.certificate, args, found)
    return code or int(not all_proven(answers))


def decide_all(
    subject: Union[Net, Plan],
    questions: List[MarkingQuestion],
    *,
    seconds: float,
    limit: int,
    standalone: bool,
    progress: Progress,
) -> List[Answer]:
    """The answers, also with the losses of robots if these are possible.

    :param seconds: time for each question (s).
    :param limit: the most markings to visit for each.
    :param standalone: whether the plan is for agents, which are never lost.
    :param progress: called with the progress.
    """
    from gspn_framework_package.analysis.proofs.ladder import decide_for_team

    losses = isinstance(subject, Plan) and may_lose_robots(subject, standalone)
    more: Dict[str, Any] = {"seconds": seconds, "limit": limit, "progress": progress}
    return [
        answer
        for question in questions
        for answer in decide_for_team(subject, question, losses=losses, **more)
    ]


def all_proven(answers: List[Answer]) -> bool:
    """Whether each question is proven, at least as long as no robot is lost."""
    proven = {a.question._replace(losses=False) for a in answers if a.certificate is not None}
    return all(answer.question._replace(losses=False) in proven for answer in answers)


def answer_text(answer: Answer) -> str:
    """The answer to a question, in a line."""
    said = "%-12s %s" % (answer.verdict, answer.question.statement)
    last = answer.steps[-1]
    if answer.sequence is not None:
        return "%s: %s leads to %s (%s)" % (
            said,
            sequence(answer.sequence),
            marking_text(answer.marking or {}),
            last.name,
        )
    if answer.certificate is not None:
        return "%s (%s: %s)" % (said, last.name, last.outcome)
    steps = "; ".join("%s: %s" % (step.name, step.outcome) for step in answer.steps)
    return "%s (%s)" % (said, steps)
