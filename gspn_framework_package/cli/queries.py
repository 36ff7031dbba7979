"""The temporal queries of ``gspn analyse``."""

from __future__ import annotations

import argparse
import json
import re
from typing import Any, Dict, Iterator, List, Mapping, Tuple, Union

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.queries.answers import QueryAnswer, answer_query
from gspn_framework_package.analysis.queries.grammar import parse_query
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.cli.limits import working
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan


def answer_queries(
    args: argparse.Namespace, subject: Union[Net, Plan], notes: List[str], limits: Limits
) -> int:
    """Answer the queries in the arguments, print the answers, and return the exit code."""
    net = subject.net if isinstance(subject, Plan) else subject
    for text in args.query:  # all are read before one is answered
        parse_query(text, [place.name for place in net.places])

    def work(progress: Progress, cancel: Cancel) -> Tuple[List[QueryAnswer], Dict[str, Any]]:
        analysis = Analysis(
            subject,
            limits=limits,
            timing=args.timing,
            structure=not args.no_structure,
            engine=args.engine,
            phases=args.phases,
            progress=progress,
            cancel=cancel,
        )
        answers = [answer_query(analysis, text) for text in args.query]
        explored = "space" in vars(analysis)
        return answers, analysis.timing._asdict() if explored else {}

    answers, timing = working(work, limits.memory)
    if args.json:
        data = {
            "name": subject.name,
            "kind": "plan" if isinstance(subject, Plan) else "net",
            "timing": timing or None,
            "queries": [answer.to_json() for answer in answers],
            "notes": notes,
        }
        print(json.dumps(data, indent=2, ensure_ascii=False))
    else:
        print_notes(notes)
        print("\n".join(query_lines(answers, timing)))
    return int(any(answer.undecided for answer in answers))


def query_lines(answers: List[QueryAnswer], timing: Mapping[str, Any]) -> Iterator[str]:
    """Answers in lines of text, then what their intervals take into account, and assumptions."""
    for answer in answers:
        yield query_text(answer)
    sources = dict.fromkeys(source for answer in answers for source in answer.interval_sources)
    if sources:
        yield "    the intervals take into account that %s" % " and ".join(sources)
    for left_out in dict.fromkeys(answer.left_out for answer in answers if answer.left_out):
        yield "    %s" % left_out
    for assumption in timing.get("assumptions", ()):
        yield "    assumed: %s" % assumption


def query_text(answer: QueryAnswer) -> str:
    """A query and its answer on one line."""
    words = []
    if answer.holds is not None:
        words.append("yes" if answer.holds else "no")
    if answer.value is not None and answer.interval is not None:
        low, high = answer.interval
        words.append("%.9g (from %.12g to %.12g)" % (answer.value, low, high))
    if answer.undecided:
        reason = re.sub("^not decided[:,]? ", "", answer.undecided)
        words.append("not decided: %s" % reason)
    if answer.sequence is not None:
        words.append("by %s" % (", ".join(answer.sequence) or "nothing: at the start"))
    if answer.holds is not None and answer.value is None:
        words[-1] += " (%s)" % answer.decided_by if answer.decided_by else ""
    return "%s: %s" % (answer.query, ", ".join(words))
