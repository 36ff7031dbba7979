"""Nets of the literature, of any size: what analysis tools are measured with."""

from __future__ import annotations

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Net


def kanban(n: int) -> Net:
    """The Kanban manufacturing system of Ciardo and Tilgner (1996) with ``n`` cards in each of its four cells, all
    transitions exponential: 160, 4600, 58400, 454475, 2546432 ... markings.

    Rates in 1/h: machines 1.2, 1.4, 1.3, 1.1; 30 % of the parts are reworked at 0.3.
    """
    net = NetBuilder("kanban_%d" % n)
    for cell in "1234":
        net.place("free" + cell, tokens=n)
        for place in ("machine", "rework", "out"):
            net.place(place + cell)
    rates = {"1": 1.2, "2": 1.4, "3": 1.3, "4": 1.1}
    for cell, rate in rates.items():
        machine, rework, out = "machine" + cell, "rework" + cell, "out" + cell
        net.exponential("fail" + cell, rate=0.3 * rate, inputs=machine, outputs=rework)
        net.exponential("good" + cell, rate=0.7 * rate, inputs=machine, outputs=out)
        net.exponential("back" + cell, rate=0.3, inputs=rework, outputs=machine)
    net.exponential("enter", rate=1.0, inputs="free1", outputs="machine1")
    net.exponential("split", rate=0.4, inputs=["out1", "free2", "free3"], outputs=["free1", "machine2", "machine3"])
    net.exponential("join", rate=0.5, inputs=["out2", "out3", "free4"], outputs=["free2", "free3", "machine4"])
    net.exponential("leave", rate=0.9, inputs="out4", outputs="free4")
    return net.build()


def philosophers(n: int) -> Net:
    """``n`` dining philosophers who take the left fork, then the right one, and can starve: 34 markings for 4,
    39202 for 12, 1331714 for 16; one deadlock. All rates 1/s."""
    net = NetBuilder("philosophers_%d" % n)
    for i in range(1, n + 1):
        net.place("think%d" % i, tokens=1).place("left%d" % i).place("eat%d" % i).place("fork%d" % i, tokens=1)
    for i in range(1, n + 1):
        right = i % n + 1
        net.exponential("take_left%d" % i, inputs=["think%d" % i, "fork%d" % i], outputs="left%d" % i)
        net.exponential("take_right%d" % i, inputs=["left%d" % i, "fork%d" % right], outputs="eat%d" % i)
        net.exponential("put%d" % i, inputs="eat%d" % i, outputs=["think%d" % i, "fork%d" % i, "fork%d" % right])
    return net.build()


def flexible_manufacturing(n: int) -> Net:
    """The flexible manufacturing system of Ciardo and Trivedi (1993) with ``n`` parts of each of three kinds:
    54, 810, 6520, 35910, 152712 ... tangible markings, and vanishing ones between them.

    Three machines of the first kind, one of the second, two of the third; parts 1 and 2 may be joined to a fourth
    kind. Transport takes 1 to 2 time units for each part by itself, finished parts are shipped in one go and replaced.
    """
    net = NetBuilder("fms_%d" % n)
    for part in "123":
        net.place("raw" + part, tokens=n)
    for machine, count in (("M1", 3), ("M2", 1), ("M3", 2)):
        net.place(machine, tokens=count)
    for part in ("1", "2", "3", "12"):
        for stage in ("wait", "work", "done", "store"):
            if stage + part != "wait3":
                net.place(stage + part)
    net.place("raw12").place("join1").place("join2")
    for part, machine, rate in (("1", "M1", 0.25), ("2", "M2", 1 / 6), ("12", "M3", 1.0)):
        net.exponential("carry" + part, rate=1.0, servers=None, inputs="raw" + part, outputs="wait" + part)
        net.immediate("load" + part, priority=2, inputs=["wait" + part, machine], outputs="work" + part)
        net.exponential("make" + part, rate=rate, servers=None, inputs="work" + part, outputs=["done" + part, machine])
    # Parts of kind 3 are made on the second machine when it has nothing else to do, and do not hold it.
    net.exponential("carry3", rate=1.0, servers=None, inputs="raw3", outputs="work3")
    net.exponential("make3", rate=0.5, inputs=["work3", "M2"], outputs=["done3", "M2"])
    for part, ship, join in (("1", 0.8, 0.2), ("2", 0.6, 0.4)):
        net.immediate("keep" + part, weight=ship, inputs="done" + part, outputs="store" + part)
        net.immediate("pass" + part, weight=join, inputs="done" + part, outputs="join" + part)
    net.immediate("keep3", inputs="done3", outputs="store3").immediate("keep12", inputs="done12", outputs="store12")
    net.immediate("join", inputs=["join1", "join2"], outputs="raw12")
    for part in "123":
        net.exponential("ship" + part, rate=1 / 60, servers=None, inputs="store" + part, outputs="raw" + part)
    net.exponential("ship12", rate=1 / 60, servers=None, inputs="store12", outputs=["raw1", "raw2"])
    return net.build()


def polling(n: int) -> Net:
    """The polling system of Ibe and Trivedi (1990): one server goes round ``n`` stations with room for one job each,
    and serves or passes by: ``3 n 2^(n-1)`` markings with every transition exponential."""
    net = NetBuilder("polling_%d" % n)
    for i in range(1, n + 1):
        net.place("idle%d" % i, tokens=1).place("job%d" % i)
        net.place("poll%d" % i, tokens=int(i == 1)).place("serve%d" % i)
    for i in range(1, n + 1):
        following = "poll%d" % (i % n + 1)
        net.exponential("arrive%d" % i, rate=1 / n, inputs="idle%d" % i, outputs="job%d" % i)
        net.exponential(
            "begin%d" % i, rate=200.0, inputs=["poll%d" % i, "job%d" % i], outputs=["serve%d" % i, "job%d" % i]
        )
        net.exponential(
            "pass%d" % i, rate=200.0, inputs=["poll%d" % i, "idle%d" % i], outputs=[following, "idle%d" % i]
        )
        net.exponential("end%d" % i, rate=1.0, inputs=["serve%d" % i, "job%d" % i], outputs=["idle%d" % i, following])
    return net.build()
