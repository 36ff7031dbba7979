"""What is asked about each family of nets."""

from __future__ import annotations

from typing import Any, Callable, Dict, Mapping, NamedTuple, Optional

from benchmarks import nets
from benchmarks.literature import chains, choices
from benchmarks.literature.answers import Between, Subject
from benchmarks.literature.choices import Choices
from benchmarks.solar_farm import HOUR, SolarFarm, solar_farm_plan
from gspn_framework_package.analysis.decisions.aims import Aim

VISITED = 3_000_000
"""Nets with more states than this are counted without visiting the states."""

Answers = Mapping[str, Callable[[Subject, int], Between]]
"""Name -> our answer to the question, for the net of a size."""


class Family(NamedTuple):
    """Nets of one kind, by size, and what can be asked about them.

    :ivar build: size -> the net, or what else is asked about.
    :ivar answers: as :data:`Answers`.
    :ivar solver: what is made of a net to be asked; None: a :class:`~.answers.Subject`.
    """

    build: Callable[[int], Any]
    answers: Mapping[str, Callable[[Any, int], Between]]
    solver: Optional[Callable[[Any], Any]] = None


def _count(number: int) -> Between:
    return Between(number, number)


VISITING: Answers = {
    "states": lambda s, n: _count(len(s.space)),
    "arcs": lambda s, n: _count(s.pairs()),
    "arcs_and_deadlocks": lambda s, n: _count(s.pairs() + len(s.space.deadlocks)),
    "tangible": lambda s, n: _count(len(s.space) - int(s.space.is_vanishing.sum())),
    "rates": lambda s, n: _count(s.chain.rates.nnz),
    "most_in_place": lambda s, n: _count(max(s.counts.bounds.values())),
    "most_tokens": lambda s, n: _count(s.counts.most_tokens),
}
"""What can be asked about every net."""

COUNTING: Answers = {
    **VISITING,
    "states": lambda s, n: _count(s.counts.total),
    "arcs": lambda s, n: _count(s.counts.arcs),
    "tangible": lambda s, n: _count(s.counts.tangible),
}
"""The same, without visiting the markings. Arcs are the same only in nets without immediate
transitions in which no two transitions have the same effect."""


def _service(n: int, most: int) -> str:
    """The cluster offers ``most`` connected workstations of ``n`` on each side."""
    return (
        "left >= {0} and to_left >= 1 or right >= {0} and to_right >= 1 or "
        "left + right >= {0} and to_left >= 1 and line >= 1 and to_right >= 1"
    ).format(most)


def _insufficient(n: int) -> str:
    return "not (%s)" % _service(n, 3 * n // 4)


def _repairs() -> Dict[str, float]:
    return {"repair_" + part: 1.0 for part in ("left", "right", "to_left", "to_right", "line")}


CLUSTER: Answers = {
    "below_min": lambda s, n: s.during(2000.0, {_insufficient(n): 1.0}),
    "operational": lambda s, n: s.at(20.0, {"left": 50.0 / n, "right": 50.0 / n}),
    "premium_steady": lambda s, n: s.long_run({_service(n, n): 1.0}),
    "qos1": lambda s, n: s.within(2000.0, _insufficient(n)),
    "qos2": lambda s, n: s.at(20.0, {_insufficient(n): 1.0}),
    "repairs": lambda s, n: s.during(2000.0, _repairs()),
}

TANDEM: Answers = {
    "customers": lambda s, n: s.long_run({"first": 1.0, "second": 1.0}),
    "customers_T": lambda s, n: s.at(0.2, {"first": 1.0, "second": 1.0}),
    "first_queue": lambda s, n: s.within(0.2, "first == %d" % n),
    "network": lambda s, n: s.within(
        1000.0, "first == %d and second == %d and phase2 == 1" % (n, n)
    ),
}

_WAITS = {"job1 >= 1 and serve1 == 0": 1.0}
POLLING: Answers = {
    "s1": lambda s, n: s.long_run(_WAITS),
    "s1_before_s2": lambda s, n: s.ever("serve1 >= 1", "serve2 >= 1"),
    "served": lambda s, n: s.during(16.0, {"end1": 1.0}),
    "waiting": lambda s, n: s.during(16.0, _WAITS),
}

_HOUR = 3600.0
_SENSORS, _ACTUATORS, _MAIN = "i >= 1 and s < 2", "o >= 1 and a < 1", "m_failed >= 1"


def _skipped(n: int) -> str:
    return "skipped >= %d" % (n + 1)


def _down(n: int) -> str:
    return " or ".join((_SENSORS, _skipped(n), _ACTUATORS, _MAIN))


def _danger(n: int) -> str:
    return "not (%s) and (i_faulty >= 1 or o_faulty >= 1)" % _down(n)


def _up(n: int) -> str:
    return "not (%s) and i_faulty == 0 and o_faulty == 0" % _down(n)


EMBEDDED: Answers = {
    "actuators": lambda s, n: s.ever(_ACTUATORS, _down(n)),
    "actuators_T": lambda s, n: s.within(12 * _HOUR, _ACTUATORS, _down(n)),
    "danger_T": lambda s, n: s.during(12 * _HOUR, {_danger(n): 1 / _HOUR}),
    "danger_time": lambda s, n: s.until(_down(n), {_danger(n): 1 / _HOUR}),
    "down_T": lambda s, n: s.during(12 * _HOUR, {_down(n): 1 / _HOUR}),
    "failure_T": lambda s, n: s.within(12 * _HOUR, _down(n)),
    "io": lambda s, n: s.ever(_skipped(n), _down(n)),
    "io_T": lambda s, n: s.within(12 * _HOUR, _skipped(n), _down(n)),
    "main": lambda s, n: s.ever(_MAIN, _down(n)),
    "main_T": lambda s, n: s.within(12 * _HOUR, _MAIN, _down(n)),
    "sensors": lambda s, n: s.ever(_SENSORS, _down(n)),
    "sensors_T": lambda s, n: s.within(12 * _HOUR, _SENSORS, _down(n)),
    "up_T": lambda s, n: s.during(12 * _HOUR, {_up(n): 1 / _HOUR}),
    "up_time": lambda s, n: s.until(_down(n), {_up(n): 1 / _HOUR}),
}

_WORTH = {"carry1": 400.0, "carry2": 600.0, "carry3": 100.0, "carry12": 1100.0}
_ASKS = "want_read + want_write + wait_network_read + wait_network_write"
_AT_NETWORK = "wait_network_read + wait_network_write"
_AT_RESOURCE = "want_read + want_write"


def _many(n: int) -> str:
    return "%s > %r" % (_ASKS, 0.8 * n)


READERS: Answers = {
    "many_requests_time": lambda s, n: s.until(_many(n)),
    "many_requests_soon": lambda s, n: s.within(5.0, _many(n)),
    "network_first": lambda s, n: s.ever(
        "%s and %s > %s" % (_many(n), _AT_NETWORK, _AT_RESOURCE), _many(n)
    ),
}


def _starved(n: int) -> str:
    return " + ".join("left%d" % i for i in range(1, n + 1)) + " == %d" % n


_CUT_OFF = "(left == 0 or to_left == 0) and (right == 0 or to_right == 0)"

FAMILIES: Mapping[str, Family] = {
    "cluster": Family(chains.cluster, CLUSTER),
    "tandem": Family(chains.tandem, TANDEM),
    "polling": Family(nets.polling, POLLING),
    "kanban": Family(nets.kanban, {"throughput": lambda s, n: s.long_run({"enter": 1.0})}),
    "fms": Family(
        nets.manufacturing_with_pallets,
        {
            "states": lambda s, n: _count(len(s.chain) if n < 5 else s.counts.tangible),
            "arcs": lambda s, n: _count(s.chain.rates.nnz),
            "productivity": lambda s, n: s.long_run(_WORTH),
        },
    ),
    "fms_joined": Family(nets.flexible_manufacturing, {}),
    "courier": Family(nets.courier, {}),
    "mapk_cascade": Family(
        chains.mapk_cascade,
        {
            "activated_T": lambda s, n: s.at(30.0, {"kpp": 1.0}),
            "activated_time": lambda s, n: s.until("kpp == %d" % n),
        },
    ),
    "embedded": Family(chains.embedded, EMBEDDED),
    "philosophers": Family(
        nets.philosophers,
        {
            "deadlock_time": lambda s, n: s.until(_starved(n)),
            "deadlock_soon": lambda s, n: s.within(1.0, _starved(n)),
        },
    ),
    "free_philosophers": Family(chains.free_philosophers, {}),
    "readers_writers": Family(nets.readers_writers, READERS),
    "stream": Family(
        choices.stream,
        {
            "buffertime": lambda c, n: c.best(
                Aim.COST_TO, "done >= 1", maximise=False, place="buffering"
            ),
            "restarts": lambda c, n: c.best(
                Aim.COST_TO, "done >= 1", maximise=True, fires="restart"
            ),
            "underrun": lambda c, n: c.best(Aim.REACH, "idle >= 1 and played >= 1", maximise=False),
        },
        solver=Choices,
    ),
    "jobs": Family(
        choices.jobs,
        {
            "completion_time": lambda c, n: c.best(
                Aim.TIME_TO, "finished == %d" % n, maximise=False
            ),
            "average_time": lambda c, n: c.best(
                Aim.COST_TO, "finished == %d" % n, maximise=True, place="unfinished", share=1 / n
            ),
        },
        solver=Choices,
    ),
    "repaired_cluster": Family(
        choices.repaired_cluster,
        {
            "longest_time": lambda c, n: c.best(Aim.COST_TO, _CUT_OFF, maximise=True),
            "shortest_time": lambda c, n: c.best(Aim.COST_TO, _CUT_OFF, maximise=False),
        },
        solver=Choices,
    ),
    "museum": Family(
        choices.museum,
        {"mean_time": lambda c, n: c.best(Aim.TIME_TO, "v8 >= 1", maximise=False)},
        solver=Choices,
    ),
    "solar_farm": Family(
        solar_farm_plan,
        {
            "states": lambda f, n: _count(len(f.team.automaton)),
            "reward_in_an_hour": lambda f, n: f.in_first(HOUR),
        },
        solver=SolarFarm,
    ),
    "erlang": Family(
        choices.erlang,
        {
            "goal_probability": lambda c, n: c.best(Aim.REACH, "goal >= 1", maximise=False),
            "goal_time": lambda c, n: c.best(Aim.TIME_TO, "goal >= 1", maximise=False),
        },
        solver=Choices,
    ),
}
"""Short name -> the nets of that kind."""
