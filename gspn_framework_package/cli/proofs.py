"""The questions of ``gspn check`` about all markings, and the files with their proofs."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
from typing import Any, Dict, Iterable, Iterator, List, Tuple, Union

from gspn_framework_package.analysis.proofs import questions
from gspn_framework_package.analysis.proofs.checker import ProofError, check_certificate
from gspn_framework_package.analysis.proofs.questions import MarkingQuestion, problem_of
from gspn_framework_package.formats.json_file import read_json
from gspn_framework_package.formats.plan_file import read_net_or_plan
from gspn_framework_package.model.errors import InputError, LimitError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

FORMAT = "gspn_proofs"


def questions_about(
    subject: Union[Net, Plan],
    *,
    never: Iterable[str] = (),
    always: Iterable[str] = (),
    apart: Iterable[str] = (),
    at_most: Iterable[str] = (),
    never_fires: Iterable[str] = (),
    returns: Iterable[str] = (),
    ends: bool = False,
    moves: bool = False,
    general: bool = False,
) -> List[MarkingQuestion]:
    """Questions about all markings of a net or plan.

    :param never: conditions that must never hold.
    :param always: conditions that must always hold.
    :param apart: patterns of the names of places that must never hold two tokens.
    :param at_most: patterns of such names, each with the most tokens (``At_*=2``).
    :param never_fires: transitions that must never fire.
    :param returns: conditions that can be reached from every marking.
    :param ends: also ask whether a plan can end from every marking.
    :param moves: also ask whether every robot can move again from every marking.
    :param general: also ask for dead markings and, of a plan, for markings without a policy row.
    :raises GspnError: one names what does not exist, or cannot be read.
    """
    kinds = [questions.DEAD, questions.NO_ROW] if isinstance(subject, Plan) else [questions.DEAD]
    found = [
        *([MarkingQuestion(kind) for kind in kinds] if general else []),
        *(MarkingQuestion(questions.NEVER, text) for text in never),
        *(MarkingQuestion(questions.ALWAYS, text) for text in always),
        *(MarkingQuestion(questions.APART, pattern) for pattern in apart),
        *(MarkingQuestion(questions.AT_MOST, text) for text in at_most),
        *(MarkingQuestion(questions.FIRES, name) for name in never_fires),
        *(MarkingQuestion(questions.RETURNS, text) for text in returns),
        *([MarkingQuestion(questions.CAN_END)] if ends else []),
        *([MarkingQuestion(questions.CAN_MOVE)] if moves else []),
    ]
    for question in found:
        if question.about or question.kind in questions.FROM_EVERYWHERE:
            with contextlib.suppress(LimitError):  # the answer will say it
                problem_of(subject, question)
    return found


def write_proofs(path: str, args: argparse.Namespace, proofs: List[Dict[str, Any]]) -> None:
    """Write the proofs to a file that names the plan or net."""
    data = {
        "format": FORMAT,
        "version": 1,
        "subject": os.path.relpath(args.plan, os.path.dirname(path) or "."),
        "robots": args.robots,
        "proofs": proofs,
    }
    with open(path, "w", encoding="utf-8") as file:
        file.write(json.dumps(data) + "\n")


def holds_proofs(path: str) -> bool:
    """Whether a file begins like one with proofs."""
    if not os.path.isfile(path):
        return False
    with open(path, "rb") as file:
        return b'"%s"' % FORMAT.encode() in file.read(100)


def checked_proofs(path: str) -> Iterator[Tuple[str, str]]:
    """Check the proofs of a file: for each the statement, and why it is refused, or "".

    :raises GspnError: the file, or the plan or net that it names, cannot be read.
    """
    data = read_json(path)
    try:
        where = os.path.join(os.path.dirname(path), data["subject"])
        robots, proofs = data["robots"], list(data["proofs"])
        asked_before = [MarkingQuestion(**proof["question"]) for proof in proofs]
    except (KeyError, TypeError) as error:
        raise InputError("these are no proofs: %r" % error, file=path) from None
    found = read_net_or_plan(where)
    subject: Union[Net, Plan] = found.plan or found.net
    if robots is not None and isinstance(subject, Plan):
        subject = subject.for_robots(robots)
    for question, proof in zip(asked_before, proofs):
        try:
            how = check_certificate(problem_of(subject, question), proof.get("certificate"))
            yield "%s (%s)" % (question.statement, how), ""
        except ProofError as error:
            yield question.statement, str(error)
