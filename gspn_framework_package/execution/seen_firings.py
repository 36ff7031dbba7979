"""The attempts at actions that follow from firings alone, without a log."""

from __future__ import annotations

from typing import Dict, Iterable, List, NamedTuple, Set, Tuple

from gspn_framework_package.model.attempt import Attempt
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.plan import Plan


class SeenFiring(NamedTuple):
    """A firing that was observed, for example in a recording: when (s), the name of the run,
    the transition, the robot that asked for it ("" if none did), and the new
    place of each robot that it moved. ``key`` identifies it in the run."""

    time: float
    run: str
    transition: str
    robot: str
    moves: Tuple[Tuple[str, str], ...]
    key: Tuple[object, ...]


def attempts_between(
    plan: Plan, firings: Iterable[SeenFiring], log: int = 0
) -> Tuple[List[Attempt], List[str]]:
    """The attempts that follow from firings alone, and notes on what does not follow.

    A firing ends a visit, not an action, so a visit is as long as the action only where the robot
    never has to wait: where nothing but its own token can disable the transitions that leave the
    place, and no policy row decides. Other places are left out. Retries and pauses are not seen.

    :param plan: the plan that was run.
    :param firings: in the order in which they were heard.
    :param log: the index that the attempts get.
    :raises LogError: a firing is not of this net.
    """
    net = plan.net
    open_places = _never_waiting(plan)
    found: List[Attempt] = []
    at: Dict[Tuple[str, str], Tuple[str, float, int]] = {}
    seen: Set[Tuple[str, Tuple[object, ...]]] = set()
    missing = 0
    last: Dict[str, float] = {}
    for firing in firings:
        t = net.transition_index.get(firing.transition)
        if t is None or any(place not in net.place_index for _, place in firing.moves):
            raise LogError("the firing of '%s' is not of this net" % firing.transition)
        if (firing.run, firing.key) in seen:
            continue
        seen.add((firing.run, firing.key))
        last[firing.run] = firing.time
        for robot, target in firing.moves:
            place, start, visit = at.get((firing.run, robot), ("", 0.0, 0))
            if place and t not in net.consumers[net.place_number(place)]:
                missing += 1
            elif place in open_places and robot == firing.robot:
                result = firing.transition if net.transitions[t].timed else ""
                ended = firing.transition not in plan.events  # else it was interrupted
                found.append(
                    Attempt(
                        robot,
                        place,
                        visit,
                        1,
                        start,
                        firing.time,
                        ended,
                        result if ended else "",
                        "",
                        log,
                    )
                )
            at[firing.run, robot] = target, firing.time, visit + 1
    for (run, robot), (place, start, visit) in at.items():
        if place in open_places:
            found.append(Attempt(robot, place, visit, 1, start, last[run], False, log=log))
    notes = [
        "firings show when robots leave, not when their actions end; retries, failures and pauses "
        "are not seen"
    ]
    left_out = [
        place
        for place in plan.action_places
        if place not in open_places and any(p == place for p, _, _ in at.values())
    ]
    if left_out:
        notes.append("robots may wait in %s, so these are left out" % ", ".join(left_out))
    if missing:
        notes.append("%d firings are missing between others" % missing)
    return found, notes


def _never_waiting(plan: Plan) -> Set[str]:
    """The places that a robot leaves as soon as its action has ended."""
    net = plan.net
    found = set()
    for place in plan.action_places:
        p = net.place_number(place)
        leaving = net.consumers[p]
        if net.immediate_from[p] and plan.policy.rows:
            continue
        if leaving and all(net.fires_alone(t, p) for t in leaving):
            found.add(place)
    return found
