#!/usr/bin/env python3
"""A campaign: questions about many small nets and plans, decided without and with visiting all
their markings.

    python3 test/campaigns/proofs.py --subjects 3000

It prints how many questions were decided by which step, and each wrong answer. Exit codes: 0 no
answer was wrong and every certificate was accepted, 1 not so.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS), str(TESTS.parent), str(TESTS / "unit" / "analysis")]

from asked_markings import can_be_reached, questions_about
from generated_nets import bounded_nets
from generated_plans import small_plans, with_events, with_tasks
from hypothesis import HealthCheck, given, seed, settings

from gspn_framework_package.analysis.proofs.checker import check_certificate
from gspn_framework_package.analysis.proofs.ladder import (
    NOT_DECIDED,
    PROVEN,
    VIOLATED,
    decide_question,
)
from gspn_framework_package.analysis.proofs.questions import problem_of
from gspn_framework_package.analysis.proofs.witness import played_to

FAMILIES = {
    "nets": bounded_nets(),
    "larger nets": bounded_nets(max_places=8, max_transitions=12, max_tokens=5),
    "plans": small_plans(),
    "events": with_events(small_plans()),
    "tasks": small_plans().flatmap(with_tasks),
}


def ask(family: str, subjects: int, limit: int, seconds: float, counts: Counter) -> int:
    """Put questions about many subjects, and return how many answers were wrong."""
    wrong = []

    @seed(1)
    @settings(
        max_examples=subjects, database=None, deadline=None, suppress_health_check=list(HealthCheck)
    )
    @given(FAMILIES[family])
    def put(subject):
        number = counts[family, "subjects"]
        counts[family, "subjects"] += 1
        for question in questions_about(subject, number):
            expected = can_be_reached(subject, question)
            answer = decide_question(subject, question, limit=limit, seconds=seconds)
            counts[family, question.kind, answer.verdict, answer.decided_by] += 1
            problem = problem_of(subject, question)
            if answer.certificate is not None:
                check_certificate(problem, answer.certificate)
            if answer.sequence is not None:
                played_to(problem, answer.sequence)
            right = {
                True: (VIOLATED, NOT_DECIDED),
                False: (PROVEN, NOT_DECIDED),
                None: (PROVEN, VIOLATED, NOT_DECIDED),
            }
            if answer.verdict not in right[expected]:
                wrong.append(number)
                print("WRONG: %s %d, %s: %s" % (family, number, question, answer), flush=True)

    put()
    return len(wrong)


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--subjects", type=int, default=3000, help="nets and plans in all")
    parser.add_argument("--limit", type=int, default=1, help="markings that an answer may visit")
    parser.add_argument("--seconds", type=float, default=0.5, help="that an answer may take")
    args = parser.parse_args()
    wrong = 0
    for family in FAMILIES:
        counts: Counter = Counter()
        begun = time.process_time()
        wrong += ask(family, args.subjects // len(FAMILIES), args.limit, args.seconds, counts)
        for what, number in sorted(counts.items()):
            print("%7d  %s" % (number, ", ".join(filter(None, what))))
        print("%7.1f  s of processor time" % (time.process_time() - begun), flush=True)
    print("%d wrong" % wrong)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
