"""The aim of a policy on the command line: rewards, or a condition to reach."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Callable, Dict, Mapping, Optional, Sequence, TypeVar

from gspn_framework_package.analysis.decisions.aims import Aim, Objective
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.options import Argument, Arguments, repeated
from gspn_framework_package.model.errors import UsageError

_Value = TypeVar("_Value")


AIM_OPTIONS: Arguments = {
    repeated("--reward", "NAME=R"): (
        "R per token in a place and second, or per firing of a transition; a negative R is a cost. "
        "NAME may be a pattern, as for files ('Seen_*=1'). Maximises the long-run average per "
        "second. May be repeated"
    ),
    Argument("--mean-time-to", "CONDITION"): "minimise the mean time until this holds",
    Argument("--cost-to", "CONDITION"): (
        "minimise the mean cost until this holds: --reward gives the costs, as positive numbers"
    ),
    Argument("--reach", "CONDITION"): "maximise the probability that this ever holds",
    Argument("--discount", "B", numbers.duration): (
        "instead of the long-run average, weight rewards at time t by exp(-B t) (B in 1/s)"
    ),
    "--minimise": "minimise the rewards or the probability instead",
}


def objective_of(args: argparse.Namespace) -> Objective:
    """The aim in the arguments. :raises UsageError: see :func:`the_objective`."""
    return the_objective(
        pairs(args.reward, "--reward", float, "NAME=NUMBER"),
        mean_time_to=args.mean_time_to,
        cost_to=args.cost_to,
        reach=args.reach,
        discount=args.discount,
        minimise=args.minimise,
    )


def the_objective(
    rewards: Mapping[str, float],
    *,
    mean_time_to: Optional[str] = None,
    cost_to: Optional[str] = None,
    reach: Optional[str] = None,
    discount: Optional[float] = None,
    minimise: bool = False,
) -> Objective:
    """The one aim that is given.

    :param rewards: name of a place or transition -> reward per token and second, or per firing.
    :param mean_time_to: a condition that is to hold as soon as possible.
    :param cost_to: a condition that is to hold at the least cost.
    :param reach: a condition that is to hold as probably as possible.
    :param discount: rate (1/s) at which later rewards count less.
    :param minimise: whether less is better.
    :raises UsageError: no aim is given, there are several, or it is inconsistent.
    """
    conditions = [
        (option, goal)
        for option, goal in (
            ("--mean-time-to", mean_time_to),
            ("--cost-to", cost_to),
            ("--reach", reach),
        )
        if goal is not None
    ]
    if len(conditions) > 1:
        raise UsageError(
            "%s and %s exclude each other: give one aim" % (conditions[0][0], conditions[1][0])
        )
    if conditions and discount is not None:
        raise UsageError("%s and --discount exclude each other" % conditions[0][0])
    option, goal = conditions[0] if conditions else ("", "")
    if rewards and option in ("--mean-time-to", "--reach"):
        raise UsageError("%s has no rewards" % option)
    if minimise and option in ("--mean-time-to", "--cost-to"):
        raise UsageError("%s is minimised in any case" % option)
    if option == "--mean-time-to":
        return Objective.time_to(goal)
    if option == "--cost-to":
        return Objective.cost_to(goal, rewards)
    if option == "--reach":
        objective = Objective.reach(goal)
    elif not rewards:
        raise UsageError(
            "no aim is given", hint="give --reward, --mean-time-to, --cost-to or --reach"
        )
    elif discount is not None:
        objective = Objective.discounted(rewards, discount)
    else:
        objective = Objective(Aim.LONG_RUN, rewards)
    return dataclasses.replace(objective, maximise=not minimise)


def pairs(
    texts: Sequence[str], option: str, read: Callable[[str], _Value], form: str
) -> Dict[str, _Value]:
    """Read ``NAME=VALUE`` texts. :raises UsageError: a text has another form, or a name occurs
    twice."""
    found: Dict[str, _Value] = {}
    for text in texts:
        name, sign, value = text.rpartition("=")
        name = name.strip()
        try:
            if not sign or not name:
                raise ValueError
            read_value = read(value)
        except ValueError:
            raise UsageError("%s '%s'" % (option, text), hint="write %s" % form) from None
        if name in found:
            raise UsageError("%s names '%s' twice" % (option, name))
        found[name] = read_value
    return found
