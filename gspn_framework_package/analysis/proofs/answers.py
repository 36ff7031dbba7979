"""The answers of a report that proofs and guided searches give, where the visited markings left
them open."""

from __future__ import annotations

from typing import Any, Dict, Iterable, List, Optional

from gspn_framework_package.analysis.analyse import Analysis, Reachability
from gspn_framework_package.analysis.plan.reading import RUN
from gspn_framework_package.analysis.proofs.ladder import (
    PROVEN,
    SECONDS,
    VIOLATED,
    Answer,
    decide_question,
)
from gspn_framework_package.analysis.proofs.questions import DEAD, NEVER, MarkingQuestion
from gspn_framework_package.analysis.state_space.space import WitnessStep
from gspn_framework_package.model.errors import ExpressionError
from gspn_framework_package.model.net import Net


def dead_marking(analysis: Analysis) -> Optional[Dict[str, Any]]:
    """Whether a net has a deadlock, as in a report; None if it is not decided.

    A plan is not asked: what robots have drawn and wait for is not in its markings.

    :raises CancelledError: the work was cancelled.
    """
    if analysis.plan is not None:
        return None
    answer = decided(analysis, MarkingQuestion(DEAD))
    if answer.verdict == PROVEN:
        return {"count": 0, "witness": None, "marking": None}
    if answer.verdict == VIOLATED:
        return {"count": None, "witness": list(answer.sequence or ()), "marking": answer.marking}
    return None


def can_hold(analysis: Analysis, condition: str) -> Optional[Reachability]:
    """Whether a condition can ever hold; None if it is not decided.

    Of a plan, what no order of firings reaches is not reached in a run either. The converse does
    not follow, since a run knows priorities and time.

    :raises CancelledError: the work was cancelled.
    """
    if analysis.plan is not None and analysis.timing.reading != RUN:
        return None
    question = MarkingQuestion(NEVER, condition)
    try:
        answer = decided(analysis, question)
    except ExpressionError:
        return None  # it asks for more than counts of places: ``deadlock``
    if answer.verdict == PROVEN:
        return Reachability(False, 0, None)
    if answer.verdict == VIOLATED and analysis.plan is None:
        return Reachability(True, 1, _steps(analysis.net, answer.sequence or ()))
    return None


def decided(analysis: Analysis, question: MarkingQuestion, limit: int = 0) -> Answer:
    """The answer of the ladder to a question about the subject of an analysis, within its time.

    :param limit: the most markings to visit; 0 for none.
    :raises CancelledError: the work was cancelled.
    :raises GspnError: the question cannot be read.
    """
    more = analysis.while_working
    more["seconds"] = min(more["seconds"], SECONDS)
    return decide_question(analysis.plan or analysis.net, question, limit=limit, **more)


def _steps(net: Net, sequence: Iterable[str]) -> List[WitnessStep]:
    """The steps of firings that were played before."""
    marking, steps = net.initial_marking, []
    for name in sequence:
        marking = net.fire(marking, net.transition_number(name))
        steps.append(WitnessStep(name, net.named(marking)))
    return steps
