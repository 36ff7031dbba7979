"""The scenarios: the faults of the network, and how the team must and must not react."""

from __future__ import annotations

import statistics
import time
from typing import Any, Callable, Dict, List

from benchmarks.harness.rules import partition
from benchmarks.harness.team import MASTER
from benchmarks.netns.experiment import PartitionExperiment, partition_experiment

Numbers = Dict[str, Any]
"""The figures that a scenario measured; times in seconds."""

HOLD = 4.0
"""Seconds for which the network stays cut, by default."""

DELAYS = {"ros": {"delayed": 0.05}, "masters": {}, "zenoh": {"100_ms": 0.1, "300_ms": 0.3}}
"""One-way delays in seconds between any two nodes (scenario ``delay``), for each transport."""

LOSSES = (0.1, 0.3)
"""Shares of the packets that are lost (scenario ``loss``)."""

FLAP = 0.5
"""Seconds from one change of the links to the next (scenario ``flapping``)."""

WINDOW = 10.0
"""Seconds for which throughput is measured."""


def minority(mode: str, hold: float = HOLD, transport: str = "ros") -> Numbers:
    """One robot of three is cut off, for less than ``evict_after``.

    It finishes its action and waits. With full synchronisation the other two go on; with partial
    synchronisation they make local transitions, but what needs everybody's answer waits. After
    healing it catches up, and nobody was evicted.
    """
    with _experiment(mode, hold, transport) as lab:
        lab.warm_up()
        numbers = _lose_robot_3(lab, hold, [MASTER, "robot_1", "robot_2"], ["robot_3"])
        return _finish(lab, numbers)


def master_side(mode: str, hold: float = HOLD, transport: str = "ros") -> Numbers:
    """First the master is alone, and all robots continue; then it is with one robot, and the two
    others, without it, behave as any majority."""
    with _experiment(mode, hold, transport) as lab:
        lab.warm_up()
        lab.part([MASTER], lab.robots)
        lab.wait_for_moves(lab.robots, 10)
        lab.heal()
        lab.wait_for_moves(lab.robots, 5)
        numbers = _lose_robot_3(lab, hold, ["robot_1", "robot_2"], [MASTER, "robot_3"])
        return _finish(lab, numbers)


def eviction(mode: str, evict_after: float = 3.0, transport: str = "ros") -> Numbers:
    """One robot is cut off for longer than ``evict_after``: it is evicted, the others continue, and
    after healing it joins with a new incarnation."""
    with partition_experiment(mode, evict_after=evict_after, transport=transport) as lab:
        lab.warm_up()
        lab.part([MASTER, "robot_1", "robot_2"], ["robot_3"])

        def evicted() -> bool:
            return any(
                e["robot"] == "robot_3" for e in lab.read()["robot_1"].entries("evict", lab.cut_at)
            )

        evicted_at = lab.wait(evicted, "the eviction")
        lab.wait_for_moves(["robot_1", "robot_2"], 10)
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
        lab.wait_for_moves(["robot_3"], 5)
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


def deaf(mode: str, hold: float = HOLD, transport: str = "ros") -> Numbers:
    """Nothing reaches robot_3, but its own messages arrive (although no acknowledgement of TCP
    comes back)."""
    return _one_way(mode, hold, transport, hears=False)


def mute(mode: str, hold: float = HOLD, transport: str = "ros") -> Numbers:
    """Nothing from robot_3 reaches the others, but it hears them: the actions that it finishes
    cannot enter the log."""
    return _one_way(mode, hold, transport, hears=True)


def _one_way(mode: str, hold: float, transport: str, hears: bool) -> Numbers:
    with _experiment(mode, hold, transport) as lab:
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
                lab.require(not own & got, "%s knows what robot_3 could not send" % name)
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


def scattered(mode: str, hold: float = HOLD, transport: str = "ros") -> Numbers:
    """All three robots and the master are isolated: nothing is decided anywhere, and after healing
    all continue."""
    with _experiment(mode, hold, transport) as lab:
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


def delay(mode: str, window: float = WINDOW, transport: str = "ros") -> Numbers:
    """50 ms from any node to any other, with a router 100 and 300 ms: the team works, but more
    slowly. The same team in the same layout without delay is measured for comparison."""
    numbers: Numbers = {}
    delays = {"none": 0.0, **DELAYS[transport]}
    for name, seconds in delays.items():
        with partition_experiment(mode, delay=seconds, transport=transport) as lab:
            times = [lab.network.travel_time("robot_1", "robot_2") for _ in range(9)]
            lab.require(None not in times, "a datagram was lost in the relay")
            began = lab.wait_for_moves(lab.robots, 1) - lab.began
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
    for name in DELAYS[transport]:
        ratio = numbers[name + "_moves_per_s"] / numbers["none_moves_per_s"]
        numbers[name + "_throughput_ratio"] = ratio
    return numbers


def router_killed(mode: str, hold: float = HOLD, transport: str = "zenoh") -> Numbers:
    """The router is killed, and restarted with the same keys: meanwhile nobody decides anything,
    afterwards all find it again by themselves."""
    with _experiment(mode, hold, transport) as lab:
        lab.warm_up()
        lab.begin_fault()
        lab.programs.kill(MASTER)
        lab.hold(hold)
        lab.end_fault()
        lab.start_middle()
        begin, end = lab.fault()
        lab.require(lab.slots(lab.robots, begin, end) == 0, "somebody decided a slot alone")
        numbers: Numbers = {"away": end - lab.cut_at, "all_on_after": _all_on_after(lab)}
        return _finish(lab, numbers)


def nat(mode: str, hold: float = HOLD, transport: str = "zenoh") -> Numbers:
    """Two robots behind one gateway, robot_3 behind another, so that no robot can be reached from
    outside. The gateway of robot_3 is cut off as in ``minority``; then it gets another address, so
    that the connection through it is lost without a word."""
    behind = {"nat_a": ["robot_1", "robot_2"], "nat_b": ["robot_3"]}
    with _experiment(mode, hold, transport, behind=behind) as lab:
        lab.warm_up()
        numbers = _lose_robot_3(lab, hold, [MASTER, "nat_a"], ["nat_b"])
        lab.begin_fault()
        lab.network.move("nat_b")
        lab.network.verify()
        lab.end_fault()
        numbers["all_on_after_a_move"] = _all_on_after(lab)
        return _finish(lab, numbers)


def loss(mode: str, window: float = WINDOW, transport: str = "zenoh") -> Numbers:
    """10 and 30 % of all packets are lost: the team works, but more slowly, and evicts nobody."""
    numbers: Numbers = {}
    for share in LOSSES:
        name = "lost_%d" % round(100 * share)
        with partition_experiment(mode, loss=share, transport=transport) as lab:
            began = lab.wait_for_moves(lab.robots, 1) - lab.began
            begin, end = lab.pass_time(window)
            moves = {robot: lab.moves(robot, begin, end) for robot in lab.robots}
            lab.require(all(moves.values()), "not every robot moves: %s" % moves)
            _require_nobody_evicted(lab)
            numbers[name + "_first_moves_after"] = began
            numbers[name + "_moves_per_s"] = sum(moves.values()) / window
            numbers[name + "_longest_pause"] = _longest_pause(lab, begin, end)
            _finish(lab, numbers)
    return numbers


def flapping(mode: str, window: float = WINDOW, transport: str = "zenoh") -> Numbers:
    """Every half second the links change: at any time every other robot is cut off from all. The
    team continues in between, and evicts nobody."""
    with partition_experiment(mode, transport=transport) as lab:
        lab.warm_up()
        lab.begin_fault()
        for step in range(round(window / FLAP)):
            cut_off = [name for k, name in enumerate(lab.robots) if (k + step) % 2]
            rest = [name for name in (MASTER, *lab.robots) if name not in cut_off]
            lab.network.cut(partition([rest, *([name] for name in cut_off)]))
            lab.pass_time(lab.cut_at + (step + 1) * FLAP - time.monotonic())
        lab.heal()
        begin, end = lab.fault()
        moves = {robot: lab.moves(robot, begin, end) for robot in lab.robots}
        lab.require(sum(moves.values()) > 0, "nobody moved while the links flapped")
        _require_nobody_evicted(lab)
        numbers: Numbers = {
            "flapped": end - lab.cut_at,
            "moves_per_s_meanwhile": sum(moves.values()) / (end - begin),
            "moves_of_the_slowest": min(moves.values()),
            "all_on_after": _all_on_after(lab),
        }
        return _finish(lab, numbers)


def _require_nobody_evicted(lab: PartitionExperiment) -> None:
    for log in lab.read().values():
        lab.require(not list(log.entries("evict")), "somebody was evicted before its time")


def _longest_pause(lab: PartitionExperiment, begin: float, end: float) -> float:
    """The longest time in which nobody entered a place."""
    goals = sorted(g["mono"] for log in lab.read().values() for g in log.of("goal", begin, end))
    times = [begin, *goals, end]
    return max(b - a for a, b in zip(times, times[1:]))


def _experiment(mode: str, hold: float, transport: str, **more: Any) -> PartitionExperiment:
    """A team in which no robot is evicted while the network is cut for ``hold`` seconds."""
    evict_after = max(15.0, 3 * hold)
    return partition_experiment(mode, evict_after=evict_after, transport=transport, **more)


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
    _require_nobody_evicted(lab)
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
    return lab.wait_for_moves(lab.robots, 1) - lab.healed_at


def _finish(lab: PartitionExperiment, numbers: Numbers) -> Numbers:
    lab.wait_for_moves(number=5)
    found = lab.finish()
    numbers.update(slots=found.slots, firings=found.firings)
    return numbers


SCENARIOS: Dict[str, Callable[..., Numbers]] = {
    "minority": minority,
    "eviction": eviction,
    "master_side": master_side,
    "mute": mute,
    "deaf": deaf,
    "scattered": scattered,
    "delay": delay,
    "loss": loss,
    "flapping": flapping,
    "nat": nat,
    "router_killed": router_killed,
}
"""Name -> a function that runs the scenario in a mode of synchronisation on a transport. Those with
a parameter ``hold`` leave the network cut for that many seconds. They raise GspnError if the team
did not behave as it must."""

TAKE_HOLD = frozenset(SCENARIOS) - {"eviction", "delay", "loss", "flapping"}
NEED_DELAY = frozenset({"delay"})
OF_TRANSPORT = {
    "ros": [name for name in SCENARIOS if name not in ("loss", "flapping", "nat", "router_killed")],
    "masters": ["minority", "eviction", "mute", "deaf", "scattered"],
    "zenoh": [name for name in SCENARIOS if name != "master_side"],
}
"""The scenarios of each transport. A router in the middle is no master: without it nobody hears
anybody. On ROS, robots behind gateways cannot reach one another."""
