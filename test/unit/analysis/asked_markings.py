"""What visiting every marking says about the questions that are put to proofs."""

import fnmatch
import itertools
import random

from generated_nets import reference_space

from gspn_framework_package.analysis.plan.markings import PlanMarkings
from gspn_framework_package.analysis.proofs.questions import (
    APART,
    DEAD,
    FIRES,
    NEVER,
    NO_ROW,
    MarkingQuestion,
)
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.net import Net

SHAPES = (
    "%(a)s >= %(m)d",
    "%(a)s + %(b)s > %(m)d",
    "%(a)s == %(m)d and %(b)s == %(n)d",
    "%(a)s >= 1 and not (%(b)s < %(m)d or %(a)s == %(b)s)",
    "2 * %(a)s - %(b)s / 2 >= %(m)d or %(b)s != %(n)d and %(a)s > 2",
    "min(%(a)s, %(b)s) >= %(m)d",
)


def questions_about(subject, seed):
    """Some questions of every kind about a net or a plan."""
    draw = random.Random(seed)
    net = subject if isinstance(subject, Net) else subject.net
    names = [place.name for place in net.places]
    for losses in (False,) if subject is net else (False, True):
        yield MarkingQuestion(DEAD, losses=losses)
        yield MarkingQuestion(APART, draw.choice([*names, "*1"]), losses)
        for shape in draw.sample(SHAPES, 3):
            counts = {"m": draw.randint(0, 3), "n": draw.randint(0, 2)}
            pair = dict(zip("ab", draw.sample(names, 2)))
            yield MarkingQuestion(NEVER, shape % {**counts, **pair}, losses)
        if subject is not net:
            yield MarkingQuestion(NO_ROW, losses=losses)
    yield MarkingQuestion(FIRES, draw.choice(net.transitions).name)


def _two_in_one(places):
    return " or ".join("%s >= 2" % place for place in places)


def can_be_reached(subject, question, limit=2_000):
    """Whether a bad marking can be reached; None if there are more markings than ``limit``."""
    if isinstance(subject, Net):
        return _in_net(subject, question)
    kept = [place.name for place in subject.net.places if question.kind in (NEVER, APART)]
    markings = PlanMarkings(subject, limit, losses=question.losses, keep=kept)
    if not markings.complete:
        return None
    if question.kind == DEAD:
        return any(True for lost in (False, True) for _ in markings.dead(after_losses=lost))
    if question.kind == NO_ROW:
        waiting = itertools.chain(markings.policy_gaps(), markings.undecided_choices())
        return next(waiting, None) is not None
    if question.kind == APART:
        places = fnmatch.filter(markings.net.place_index, question.about)
        return bool((markings.reached & markings.space.holds(_two_in_one(places))).any())
    if question.kind == FIRES:
        return question.about not in markings.never_fire()
    return bool((markings.space.holds(question.about) & markings.reached).any())


def _in_net(net, question):
    graph = reference_space(net)
    if question.kind == DEAD:
        return not all(graph.values())
    if question.kind == FIRES:
        return any(net.transition_number(question.about) in after for after in graph.values())
    if question.kind == APART:
        question = MarkingQuestion(
            NEVER, _two_in_one(fnmatch.filter(net.place_index, question.about))
        )
    condition = parse_condition(question.about, [place.name for place in net.places])
    return any(map(condition.holds, graph))
