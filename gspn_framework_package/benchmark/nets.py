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
