"""The scenarios: the faults of the network, and how the team must and must not react."""

from __future__ import annotations

import statistics
from typing import Any, Callable, Dict, List

from gspn_framework_package.benchmark.netns.experiment import PartitionExperiment
from gspn_framework_package.benchmark.netns.team import MASTER

Numbers = Dict[str, Any]
"""The figures that a scenario measured; times in seconds."""

HOLD = 4.0
"""Seconds for which the network stays cut, by default."""

DELAY = 0.05
"""One-way delay in seconds between any two nodes (scenario ``delay``)."""

WINDOW = 10.0
"""Seconds for which throughput is measured."""


def minority(mode: str, hold: float = HOLD) -> Numbers:
    """One robot of three is cut off, for less than ``evict_after``.

    It finishes its action and waits. With full synchronisation the other two go on; with partial
    synchronisation they make local transitions, but what needs everybody's answer waits. After
    healing it catches up, and nobody was evicted.
    """
    with _experiment(mode, hold) as lab:
        lab.warm_up()
        numbers = _lose_robot_3(lab, hold, [MASTER, "robot_1", "robot_2"], ["robot_3"])
        return _finish(lab, numbers)


def master_side(mode: str, hold: float = HOLD) -> Numbers:
    """First the master is alone, and all robots continue; then it is with one robot, and the two
    others, without it, behave as any majority."""
    with _experiment(mode, hold) as lab:
        lab.warm_up()
        lab.part([MASTER], lab.robots)
        lab.wait_for_moves(lab.robots, 10, "of each robot without the master")
        lab.heal()
        lab.wait_for_moves(lab.robots, 5, "of each robot with the master again")
        numbers = _lose_robot_3(lab, hold, ["robot_1", "robot_2"], [MASTER, "robot_3"])
        return _finish(lab, numbers)


def eviction(mode: str, evict_after: float = 3.0) -> Numbers:
    """One robot is cut off for longer than ``evict_after``: it is evicted, the others continue, and
    after healing it joins with a new incarnation."""
    with PartitionExperiment(mode, evict_after=evict_after) as lab:
        lab.warm_up()
        lab.part([MASTER, "robot_1", "robot_2"], ["robot_3"])

        def evicted() -> bool:
            return any(
                e["robot"] == "robot_3" for e in lab.read()["robot_1"].entries("evict", lab.cut_at)
            )

        evicted_at = lab.wait(evicted, "the eviction")
        lab.wait_for_moves(["robot_1", "robot_2"], 10, "of the two that are left")
        lab.heal()

        def joined() -> bool:
            return all(
                any(
                    e["robot"] == "robot_3" and e["incarnation"] > 0
                    for e in log.entries("join", lab.healed_at)
                )
                for log in lab.read().values()
            )

        joined_at = lab.wait(joined, "robot_3 to join again")
        lab.wait_for_moves(["robot_3"], 5, "of robot_3 after its return")
        goals = lab.read()["robot_3"].of("goal", joined_at)
        lab.require(goals[-1]["incarnation"] > 0, "robot_3 acts under its old incarnation")
        begin, end = lab.fault()
        lab.require(
            not list(lab.read()["robot_3"].of("slot", begin, end)),
            "robot_3 decided slots without a quorum",
        )
        return _finish(
            lab,
            {
                "cut": end - lab.cut_at,
                "evicted_after": evicted_at - lab.cut_at,
                "joined_after": joined_at - lab.healed_at,
                "moves_of_the_others": lab.moves("robot_1", evicted_at, end)
                + lab.moves("robot_2", evicted_at, end),
            },
        )


def deaf(mode: str, hold: float = HOLD) -> Numbers:
    """Nothing reaches robot_3, but its own messages arrive (although no acknowledgement of TCP
    comes back)."""
    return _one_way(mode, hold, hears=False)


def mute(mode: str, hold: float = HOLD) -> Numbers:
    """Nothing from robot_3 reaches the others, but it hears them: the actions that it finishes
    cannot enter the log."""
    return _one_way(mode, hold, hears=True)


def _one_way(mode: str, hold: float, hears: bool) -> Numbers:
    with _experiment(mode, hold) as lab:
        lab.warm_up()
        others = [MASTER, "robot_1", "robot_2"]
        if hears:
            lab.drop(["robot_3"], others)
        else:
            lab.drop(others, ["robot_3"])
        lab.hold(hold)
        lab.heal()
        begin, end = lab.fault()
        if hears:
            own = {(e["incarnation"], e["visit"]) for e in _finished(lab, "robot_3", begin, end)}
            for name in ("robot_1", "robot_2"):
                got = {
                    (e["incarnation"], e["visit"])
                    for e in lab.read()[name].entries("done", begin, end)
                    if e["robot"] == "robot_3"
                }
                lab.require(not own & got, "%s knows what robot_3 could not tell" % name)
        numbers = _progress_of_others(lab, ["robot_1", "robot_2"])
        numbers["moves_of_robot_3"] = lab.moves("robot_3", begin, end)
        numbers["caught_up_after"] = lab.catch_up(lab.robots, lab.robots)
        numbers["all_on_after"] = _all_on_after(lab)
        return _finish(lab, numbers)


def _finished(lab: PartitionExperiment, robot: str, begin: float, end: float) -> List[Any]:
    return [
        r["entry"]
        for r in lab.read()[robot].of("invoked", begin, end)
        if r["entry"]["entry"] == "done"
    ]


def scattered(mode: str, hold: float = HOLD) -> Numbers:
    """All three robots and the master are isolated: nothing is decided anywhere, and after healing
    all continue."""
    with _experiment(mode, hold) as lab:
        lab.warm_up()
        lab.part([MASTER], *([name] for name in lab.robots))
        lab.hold(hold)
        lab.heal()
        begin, end = lab.fault()
        lab.require(lab.slots(lab.robots, begin, end) == 0, "somebody decided a slot alone")
        moves = sum(lab.moves(name, begin, end) for name in lab.robots)
        lab.require(lab.partial or moves == 0, "somebody moved alone")
        numbers: Numbers = {"cut": end - lab.cut_at, "private_moves_alone": moves}
        numbers["all_on_after"] = _all_on_after(lab)
        return _finish(lab, numbers)


def delay(mode: str, window: float = WINDOW) -> Numbers:
    """50 ms from any node to any other: the team works, but more slowly. The same team in the same
    layout without delay is measured for comparison."""
    numbers: Numbers = {}
    for name, seconds in (("none", 0.0), ("delayed", DELAY)):
        with PartitionExperiment(mode, delay=seconds) as lab:
            times = [lab.network.travel_time("robot_1", "robot_2") for _ in range(9)]
            lab.require(None not in times, "a datagram was lost in the relay")
            began = lab.wait_for_moves(lab.robots, 1, "of each robot") - lab.began
            lab.wait(lab.all_were_everywhere, "each robot to act in every place", 120.0)
            begin, end = lab.pass_time(window)
            commits = [t for log in lab.read().values() for t in log.commit_times(begin, end)]
            moves = sum(lab.moves(r, begin, end) for r in lab.robots)
            lab.require(
                all(lab.moves(r, begin, end) > 0 for r in lab.robots), "not every robot moves"
            )
            measured = {
                "first_moves_after": began,
                "one_way_ms": 1e3 * statistics.median(t for t in times if t is not None),
                "moves_per_s": moves / window,
                "commit_ms_median": 1e3 * statistics.median(commits),
            }
            numbers.update({"%s_%s" % (name, key): value for key, value in measured.items()})
            _finish(lab, numbers)
    numbers["throughput_ratio"] = numbers["delayed_moves_per_s"] / numbers["none_moves_per_s"]
    return numbers


def _experiment(mode: str, hold: float) -> PartitionExperiment:
    """A team in which no robot is evicted while the network is cut for ``hold`` seconds."""
    return PartitionExperiment(mode, evict_after=max(15.0, 3 * hold))


def _lose_robot_3(
    lab: PartitionExperiment, hold: float, majority: List[str], rest: List[str]
) -> Numbers:
    lab.part(majority, rest)
    lab.hold(hold)
    lab.heal()
    begin, end = lab.fault()
    cut_off = lab.read()["robot_3"]
    lab.require(not cut_off.of("slot", begin, end), "robot_3 decided slots without a quorum")
    waits_since = max((g["mono"] for g in cut_off.of("goal", 0, end)), default=begin) - lab.cut_at
    lab.require(waits_since < hold - 1, "robot_3 went on all the time")
    numbers = _progress_of_others(lab, ["robot_1", "robot_2"])
    numbers["moves_of_robot_3"] = lab.moves("robot_3", begin, end)
    numbers["caught_up_after"] = lab.catch_up(["robot_3"], ["robot_1", "robot_2"])
    numbers["all_on_after"] = _all_on_after(lab)
    for log in lab.read().values():
        lab.require(not list(log.entries("evict")), "somebody was evicted before its time")
    return numbers


def _progress_of_others(lab: PartitionExperiment, others: List[str]) -> Numbers:
    """What the majority did meanwhile. With full synchronisation it must continue; with partial
    synchronisation it needs the answers of all robots that are not evicted."""
    begin, end = lab.fault()
    slots = lab.slots(others, begin, end)
    moves = {name: lab.moves(name, begin, end) for name in others}
    lab.require(
        lab.partial or all(n >= 3 for n in moves.values()), "the majority stood still: %s" % moves
    )
    return {
        "cut": end - lab.cut_at,
        "slots_of_the_others": slots,
        "moves_of_the_others": sum(moves.values()),
    }


def _all_on_after(lab: PartitionExperiment) -> float:
    """Seconds from healing until every robot moves again."""
    return lab.wait_for_moves(lab.robots, 1, "of each robot after healing") - lab.healed_at


def _finish(lab: PartitionExperiment, numbers: Numbers) -> Numbers:
    history = lab.finish()
    numbers.update(slots=history.slots, firings=history.firings, marking=history.marking)
    return numbers


SCENARIOS: Dict[str, Callable[..., Numbers]] = {
    "minority": minority,
    "eviction": eviction,
    "master_side": master_side,
    "mute": mute,
    "deaf": deaf,
    "scattered": scattered,
    "delay": delay,
}
"""Name -> a function that runs the scenario in a mode of synchronisation. Those with a parameter
``hold`` leave the network cut for that many seconds. They raise GspnError if the team did not
behave as it must."""

TAKE_HOLD = frozenset(SCENARIOS) - {"eviction", "delay"}
NEED_DELAY = frozenset({"delay"})
