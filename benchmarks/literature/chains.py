"""Markov chains of the literature as nets, transcribed from what their sources say.

Rates are per time unit of the source: hours (cluster), seconds (embedded), minutes (mainframe).
"""

from __future__ import annotations

from itertools import product
from typing import Dict, List, Sequence, Tuple

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Net


def cluster(n: int, choice: bool = False) -> Net:
    """The workstation cluster of Haverkort, Hermanns and Katoen (2000): two sides with ``n``
    workstations and a switch each, joined by a line. One repairman inspects what is down, and then
    repairs one.

    :param choice: the inspection takes no time, and the repairman chooses.
    """
    net = NetBuilder("cluster_%d" % n).place("idle", tokens=1)
    parts = (
        ("left", n, 1 / 500, 2.0),
        ("right", n, 1 / 500, 2.0),
        ("to_left", 1, 1 / 4000, 0.25),
        ("to_right", 1, 1 / 4000, 0.25),
        ("line", 1, 1 / 5000, 0.125),
    )
    for part, count, fails, repair in parts:
        down, busy = "down_" + part, "repairs_" + part
        net.place(part, tokens=count).place(down).place(busy)
        net.exponential("fail_" + part, fails, None, inputs=part, outputs=down)
        if choice:
            net.immediate("start_" + part, 0, inputs=["idle", down], outputs=[busy, down])
        else:
            net.exponential("start_" + part, 10.0, inputs=["idle", down], outputs=[busy, down])
        net.exponential("repair_" + part, repair, inputs=[busy, down], outputs=["idle", part])
    return net.build()


def tandem(c: int) -> Net:
    """The tandem queue of Hermanns, Meyer-Kayser and Siegle (1999): two queues with room for ``c``
    customers each; the first server has two phases, the second of which one in ten needs."""
    net = NetBuilder("tandem_%d" % c).place("room1", tokens=c).place("room2", tokens=c)
    net.place("first").place("second").place("phase1", tokens=1).place("phase2")
    net.exponential("arrive", 4.0 * c, inputs="room1", outputs="first")
    net.exponential("turn", 0.2, inputs=["first", "phase1"], outputs=["first", "phase2"])
    passed = ["room1", "phase1", "second"]
    net.exponential("pass1", 1.8, inputs=["first", "phase1", "room2"], outputs=passed)
    net.exponential("pass2", 2.0, inputs=["first", "phase2", "room2"], outputs=passed)
    net.exponential("leave", 4.0, inputs="second", outputs="room2")
    return net.build()


def free_philosophers(n: int) -> Net:
    """The philosophers of the Model Checking Contest, who take their two forks in any order: each
    fork lies on the table or is held by one of two, so there are 3^n markings. Each free fork can
    be taken by two, and who holds both may put them down: 7 n 3^(n-2) arcs."""
    net = NetBuilder("free_philosophers_%d" % n)
    for i in range(n):
        for place in ("think", "fork"):
            net.place("%s%d" % (place, i), tokens=1)
        for place in ("left", "right", "eat"):
            net.place("%s%d" % (place, i))
    for i in range(n):
        think, left, right, eat = ("%s%d" % (p, i) for p in ("think", "left", "right", "eat"))
        forks = ["fork%d" % i, "fork%d" % ((i + 1) % n)]
        for side, fork, other in ((left, forks[0], right), (right, forks[1], left)):
            net.exponential("first_" + side, inputs=[think, fork], outputs=side)
            net.exponential("second_" + side, inputs=[other, fork], outputs=eat)
        net.exponential("put%d" % i, inputs=eat, outputs=[think, *forks])
    return net.build()


_REACTIONS = (
    ("kkk", "e1", "kkkp"),
    ("kkkp", "e2", "kkk"),
    ("kk", "kkkp", "kkp"),
    ("kkp", "kkptase", "kk"),
    ("kkp", "kkkp", "kkpp"),
    ("kkpp", "kkptase", "kkp"),
    ("k", "kkpp", "kp"),
    ("kp", "kptase", "k"),
    ("kp", "kkpp", "kpp"),
    ("kpp", "kptase", "kp"),
)
"""What an enzyme of the cascade makes of what: (substrate, enzyme, product)."""


def mapk_cascade(n: int) -> Net:
    """The signalling cascade of Huang and Ferrell (1996) with ``n`` molecules of each of the three
    kinases and one of each other enzyme: each of ten reactions binds (rate 1/``n``), and then lets
    go of or changes what it bound (150)."""
    net = NetBuilder("mapk_%d" % n)
    for species in ("kkk", "kk", "k"):
        net.place(species, tokens=n)
    for enzyme in ("e1", "e2", "kkptase", "kptase"):
        net.place(enzyme, tokens=1)
    for species in ("kkkp", "kkp", "kkpp", "kp", "kpp"):
        net.place(species)
    for substrate, enzyme, made in _REACTIONS:
        bound = "%s_%s" % (substrate, enzyme)
        both = [substrate, enzyme]
        net.place(bound)
        rate = "%r * #%s * #%s" % (1 / n, substrate, enzyme)
        net.exponential("bind_" + bound, rate, inputs=both, outputs=bound)
        net.exponential("free_" + bound, 150.0, None, inputs=bound, outputs=both)
        net.exponential("change_" + bound, 150.0, None, inputs=bound, outputs=[made, enzyme])
    return net.build()


Arcs = Tuple[List[str], List[str], List[str]]
"""Inputs, outputs and inhibitors that test something, without changing it."""


def _tested(*tests: Dict[str, int]) -> Arcs:
    """Arcs that hold while each place has at least so many tokens (-k: fewer than k)."""
    read: List[str] = []
    absent: List[str] = []
    for test in tests:
        for place, count in test.items():
            (read if count > 0 else absent).extend([place] * abs(count))
    return read, list(read), absent


def embedded(most: int) -> Net:
    """The embedded control system of Muppala, Ciardo and Trivedi (1994), as Kwiatkowska, Norman and
    Parker (2007) model it: three sensors, two actuators, an input, a main and an output processor
    and a bus. The main processor is shut down after more than ``most`` skipped cycles."""
    year, day = 365 * 24 * 3600.0, 24 * 3600.0
    net = NetBuilder("embedded_%d" % most).place("s", tokens=3).place("a", tokens=2)
    for side in "io":
        net.place(side, tokens=1).place(side + "_faulty").place(side + "_failed")
    net.place("m", tokens=1).place("m_failed").place("skipped").place("room", tokens=most + 1)
    for flag, value in (("comp", 1), ("reqi", 1), ("reqo", 0)):
        net.place(flag, tokens=value).place("no_" + flag, tokens=1 - value)
    net.exponential("fail_s", "#s / %r" % (30 * day), inputs={"s": 2}, outputs="s")
    net.exponential("fail_a", "#a / %r" % (60 * day), inputs="a")
    for side, part, need in (("i", "s", 2), ("o", "a", 1)):
        parts = [part] * need
        for state in (side, side + "_faulty"):
            net.exponential(
                "fail_" + state,
                1 / year,
                inputs=[state, *parts],
                outputs=[side + "_failed", *parts],
            )
        net.exponential(
            "fault_" + side, 1 / day, inputs=[side, *parts], outputs=[side + "_faulty", *parts]
        )
    net.exponential("fail_m", 1 / year, inputs="m", outputs="m_failed")
    for comp, reqi, reqo, m in product((False, True), repeat=4):
        before = (comp, reqi, reqo)
        ready = ({"i": 1, "s": 2}, {"i": 1, "s": -2}, {"i": -1})
        drives = ({"o": 1, "a": 1}, {"o": 1, "a": -1}, {"o": -1})
        name = "%d%d%d%d" % (comp, reqi, reqo, m)
        for k, output in enumerate(drives):
            after = (comp or (m and not reqo), True, k > 0 and (reqo or m))
            _cycle(net, "reboot_i_%s_%d" % (name, k), "i", before, m, after, _tested(output))
        for k, source in enumerate(ready):
            after = (comp or (reqi and m), k == 0 or (reqi and not m), False)
            _cycle(net, "reboot_o_%s_%d" % (name, k), "o", before, m, after, _tested(source))
        for (k, source), (j, output) in product(enumerate(ready), enumerate(drives)):
            after = (
                reqi and not reqo and m,
                k == 0 or (reqi and (reqo or not m)),
                j > 0 and (reqo or (reqi and m)),
            )
            tested = _tested(source, output)
            _cycle(net, "timeout_%s_%d%d" % (name, k, j), most, before, m, after, tested)
    return net.build()


def _cycle(
    net: NetBuilder,
    name: str,
    kind: object,
    before: Sequence[bool],
    m: bool,
    after: Sequence[bool],
    tested: Arcs,
) -> None:
    """Add what changes the flags of the bus: a reboot of processor ``i`` or ``o``, or a timeout,
    given by the number of cycles that may be skipped."""
    flags = ("comp", "reqi", "reqo")

    def named(values: Sequence[bool]) -> List[str]:
        return [flag if value else "no_" + flag for flag, value in zip(flags, values)]

    read, kept, absent = tested
    main = "m" if m else "m_failed"
    inputs, outputs = [*named(before), main, *read], [*named(after), main, *kept]
    if kind in ("i", "o"):
        side = str(kind)
        need = ["s", "s"] if side == "i" else ["a"]
        inputs, outputs = [*inputs, side + "_faulty", *need], [*outputs, side, *need]
        net.exponential(name, 1 / 30, inputs=inputs, outputs=outputs, inhibitors=absent)
    elif before[0]:  # the counter returns to 0
        assert isinstance(kind, int)
        for count in range(kind + 2):
            net.exponential(
                "%s_%d" % (name, count),
                1 / 60,
                inputs=[*inputs, *["skipped"] * count, *["room"] * (kind + 1 - count)],
                outputs=[*outputs, *["room"] * (kind + 1)],
                inhibitors=absent,
            )
    else:
        counted = [*inputs, "room"], [*outputs, "skipped"]
        net.exponential(name, 1 / 60, inputs=counted[0], outputs=counted[1], inhibitors=absent)
        full = {place: inputs.count(place) for place in inputs}
        net.exponential(
            name + "_full", 1 / 60, inputs=full, outputs=outputs, inhibitors=[*absent, "room"]
        )
    return
