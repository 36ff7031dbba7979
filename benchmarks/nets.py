"""Nets from the literature, of any size, that serve as benchmarks of analysis tools."""

from __future__ import annotations

from typing import Callable, Mapping, Tuple

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Net


def kanban(n: int) -> Net:
    """The Kanban manufacturing system of Ciardo and Tilgner (1996) with ``n`` cards in each of its
    four cells, all transitions exponential: 160, 4600, 58400, 454475, 2546432 ... markings.

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
    net.exponential(
        "split",
        rate=0.4,
        inputs=["out1", "free2", "free3"],
        outputs=["free1", "machine2", "machine3"],
    )
    net.exponential(
        "join", rate=0.5, inputs=["out2", "out3", "free4"], outputs=["free2", "free3", "machine4"]
    )
    net.exponential("leave", rate=0.9, inputs="out4", outputs="free4")
    return net.build()


def philosophers(n: int) -> Net:
    """``n`` dining philosophers who take the left fork, then the right one, and can starve: 34
    markings for 4, 39202 for 12, 1331714 for 16; one deadlock. All rates 1/s."""
    net = NetBuilder("philosophers_%d" % n)
    for i in range(1, n + 1):
        net.place("think%d" % i, tokens=1).place("left%d" % i).place("eat%d" % i).place(
            "fork%d" % i, tokens=1
        )
    for i in range(1, n + 1):
        right = i % n + 1
        net.exponential(
            "take_left%d" % i, inputs=["think%d" % i, "fork%d" % i], outputs="left%d" % i
        )
        net.exponential(
            "take_right%d" % i, inputs=["left%d" % i, "fork%d" % right], outputs="eat%d" % i
        )
        net.exponential(
            "put%d" % i, inputs="eat%d" % i, outputs=["think%d" % i, "fork%d" % i, "fork%d" % right]
        )
    return net.build()


def machines(n: int) -> Net:
    """``n`` equal machines, each with its own places, that share two tools: each asks for one
    (1/s), takes it as soon as one is free, and works with it (2/s)."""
    net = NetBuilder("machines_%d" % n).place("tools", tokens=2)
    for i in range(1, n + 1):
        net.place("idle%d" % i, tokens=1).place("waits%d" % i).place("works%d" % i)
    for i in range(1, n + 1):
        net.exponential("ask%d" % i, rate=1.0, inputs="idle%d" % i, outputs="waits%d" % i)
        net.immediate("take%d" % i, inputs=["waits%d" % i, "tools"], outputs="works%d" % i)
        net.exponential(
            "end%d" % i, rate=2.0, inputs="works%d" % i, outputs=["idle%d" % i, "tools"]
        )
    return net.build()


def flexible_manufacturing(n: int) -> Net:
    """The flexible manufacturing system of Ciardo and Trivedi (1993) with ``n`` parts of each of
    three kinds: 54, 810, 6520, 35910, 152712 ... tangible markings, and vanishing ones between
    them.

    Three machines of the first kind, one of the second, two of the third; parts 1 and 2 may be
    joined to a fourth kind. Transport takes 1 to 2 time units for each part independently; finished
    parts are shipped together and replaced.
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
        net.exponential(
            "carry" + part, rate=1.0, servers=None, inputs="raw" + part, outputs="wait" + part
        )
        net.immediate(
            "load" + part, priority=2, inputs=["wait" + part, machine], outputs="work" + part
        )
        net.exponential(
            "make" + part,
            rate=rate,
            servers=None,
            inputs="work" + part,
            outputs=["done" + part, machine],
        )
    # Parts of kind 3 are made on the second machine when it is idle, and do not occupy it.
    net.exponential("carry3", rate=1.0, servers=None, inputs="raw3", outputs="work3")
    net.exponential("make3", rate=0.5, inputs=["work3", "M2"], outputs=["done3", "M2"])
    for part, ship, join in (("1", 0.8, 0.2), ("2", 0.6, 0.4)):
        net.immediate("keep" + part, weight=ship, inputs="done" + part, outputs="store" + part)
        net.immediate("pass" + part, weight=join, inputs="done" + part, outputs="join" + part)
    net.immediate("keep3", inputs="done3", outputs="store3").immediate(
        "keep12", inputs="done12", outputs="store12"
    )
    net.immediate("join", inputs=["join1", "join2"], outputs="raw12")
    for part in "123":
        net.exponential(
            "ship" + part, rate=1 / 60, servers=None, inputs="store" + part, outputs="raw" + part
        )
    net.exponential("ship12", rate=1 / 60, servers=None, inputs="store12", outputs=["raw1", "raw2"])
    return net.build()


def manufacturing_with_pallets(n: int) -> Net:
    """The flexible manufacturing system as its authors time it: parts of all kinds share floor(3
    n / 2) pallets on their way to the machines, and finished parts of a kind leave all at once."""
    net = NetBuilder("pallets_%d" % n)
    for part, machine, machines, kept, joined in (
        ("1", "M1", 3, 0.8, 0.2),
        ("2", "M2", 1, 0.6, 0.4),
        ("3", "", 0, 1.0, 0.0),
        ("12", "M3", 2, 1.0, 0.0),
    ):
        raw, wait, work, done, store, truck = (
            stage + part for stage in ("raw", "wait", "work", "done", "store", "truck")
        )
        net.place(raw, tokens=0 if part == "12" else n).place(work).place(done).place(store)
        pallets = "min(1, %d / (#raw1 + #raw2 + #raw3 + #raw12))" % (3 * n // 2)
        carried = wait if machine else work
        net.exponential("carry" + part, "#%s * %s" % (raw, pallets), inputs=raw, outputs=carried)
        if machine:
            net.place(machine, tokens=machines).place(wait)
            net.immediate("load" + part, priority=2, inputs=[wait, machine], outputs=work)
            rate = {"1": 1 / 4, "2": 1 / 6, "12": 1.0}[part]
            net.exponential(
                "make" + part, "%r * #%s" % (rate, work), inputs=work, outputs=[done, machine]
            )
        net.immediate("keep" + part, weight=kept, inputs=done, outputs=store)
        if joined:
            net.place("join" + part)
            net.immediate("pass" + part, weight=joined, inputs=done, outputs="join" + part)
        fresh = ["raw1", "raw2"] if part == "12" else [raw]
        net.place(truck)
        net.exponential("ship" + part, 1 / 60, inputs=store, outputs=[truck, *fresh])
        net.immediate("add" + part, priority=4, inputs=[truck, store], outputs=[truck, *fresh])
        net.immediate("leave" + part, priority=3, inputs=truck)
    net.exponential("make3", 0.5, inputs=["work3", "M2"], outputs=["done3", "M2"])
    net.immediate("join", inputs=["join1", "join2"], outputs="raw12")
    return net.build()


def polling(n: int) -> Net:
    """The polling system of Ibe and Trivedi (1990): one server visits ``n`` stations in turn, each
    with room for one job, and serves or skips them. It has ``3 n 2^(n-1)`` markings with every
    transition exponential."""
    net = NetBuilder("polling_%d" % n)
    for i in range(1, n + 1):
        net.place("idle%d" % i, tokens=1).place("job%d" % i)
        net.place("poll%d" % i, tokens=int(i == 1)).place("serve%d" % i)
    for i in range(1, n + 1):
        following = "poll%d" % (i % n + 1)
        net.exponential("arrive%d" % i, rate=1 / n, inputs="idle%d" % i, outputs="job%d" % i)
        net.exponential(
            "begin%d" % i,
            rate=200.0,
            inputs=["poll%d" % i, "job%d" % i],
            outputs=["serve%d" % i, "job%d" % i],
        )
        net.exponential(
            "pass%d" % i,
            rate=200.0,
            inputs=["poll%d" % i, "idle%d" % i],
            outputs=[following, "idle%d" % i],
        )
        net.exponential(
            "end%d" % i,
            rate=1.0,
            inputs=["serve%d" % i, "job%d" % i],
            outputs=["idle%d" % i, following],
        )
    return net.build()


def courier(window: int, space: int = 1) -> Net:
    """The Courier protocol software of Woodside and Li (1991): a message goes from one application
    to the other through session and transport layers, with at most ``window`` unacknowledged
    packets and room for ``space`` messages in the sender's transport layer: 11700, 84600, 419400
    ... tangible markings, 29010 in all for a window of 1.

    Places and transitions are numbered as in the paper (there is no ``p7``), and the rates follow
    its times. Each transition has one server. A message continues in another fragment as often as
    it ends (the paper's ratio q1 : q2 is 1).
    """
    net = NetBuilder("courier_%d" % window)
    tokens = dict.fromkeys((1, 3, 6, 10, 12, 32, 37, 39, 41, 44, 46), 1)
    tokens.update({14: window, 17: space})
    for number in range(1, 47):
        if number != 7:
            net.place("p%d" % number, tokens=tokens.get(number, 0))
    for number, time, before, after in _COURIER:
        inputs, outputs = ["p%d" % p for p in before], ["p%d" % p for p in after]
        if time:
            net.exponential("t%d" % number, rate=5000 / time, inputs=inputs, outputs=outputs)
        else:
            net.immediate("t%d" % number, inputs=inputs, outputs=outputs)
    return net.build()


_COURIER: Tuple[Tuple[int, float, Tuple[int, ...], Tuple[int, ...]], ...] = (
    # The sender: application, session layer, transport layer (p12 is its task, p14 the window).
    (1, 0.68, (1,), (2,)),
    (2, 0, (2, 3), (1, 4)),
    (3, 0.57, (4, 6), (3, 5)),
    (4, 4.97, (5,), (8,)),
    (5, 0, (8, 10), (6, 9)),
    (6, 0.57, (9, 12, 17), (10, 11)),
    (7, 2.88, (11,), (12, 13)),
    (8, 0, (12, 13, 14), (13, 15)),  # a fragment followed by another
    (9, 0, (12, 13, 14), (16,)),  # the last fragment
    (10, 4.29, (15,), (12, 18)),
    (11, 4.29, (16,), (12, 19)),
    (12, 1.09, (20,), (12, 14)),
    (13, 0, (12, 18), (21,)),
    (14, 0, (12, 19), (22,)),
    (15, 0, (12, 23), (20,)),
    (16, 0.39, (21,), (12, 24)),
    (17, 0.39, (22,), (12, 17, 25)),
    # The network: acknowledgements in one direction, fragments in the other.
    (18, 10.37, (26,), (23,)),
    (20, 10.37, (24,), (28,)),
    (21, 10.37, (25,), (29,)),
    # The receiver: transport layer (p32 is its task), session layer, application.
    (19, 1.09, (27,), (26, 32)),
    (22, 0, (32, 33), (27,)),
    (23, 0, (28, 32), (30,)),
    (24, 0, (29, 32), (31,)),
    (25, 4.29, (30,), (32, 33)),
    (26, 4.29, (31,), (32, 34)),
    (27, 0, (32, 34), (33, 35)),
    (28, 3.45, (35, 37), (32, 36)),
    (29, 0, (36, 39), (37, 38)),
    (30, 0.57, (38, 41), (39, 40)),
    (31, 4.97, (40,), (42,)),
    (32, 0, (42, 44), (41, 43)),
    (33, 0.57, (43, 46), (44, 45)),
    (34, 1.25, (45,), (46,)),
)
"""Transition, mean time (in 1/5000 s; 0: immediate), input and output places of the Courier
protocol."""


def readers_writers(k: int) -> Net:
    """``k`` processes that read (many at once) or write (alone) a database and then use a network:
    figure 5.3 of Ajmone Marsan et al. (1995), with the rates and weights of the Quantitative
    Verification Benchmark Set.

    With 5 processes, the mean time until all of them wait (for the database or the network) for the
    first time is 263.0295997. Processes think and read independently. Writing takes precedence over
    reading, reading over the choice of what to do; the network and the choice to continue come
    last, by their weights.
    """
    net = NetBuilder("readers_writers_%d" % k)
    net.place("think", tokens=k).place("database", tokens=1).place("network", tokens=1)
    for place in ("request", "again"):
        net.place(place)
    for kind in ("read", "write"):
        for stage in ("want_", "do_", "wait_network_", "send_"):
            net.place(stage + kind)
    net.exponential("finish_thinking", rate=1.0, servers=None, inputs="think", outputs="request")
    for kind, weight, rate in (("read", 8.0, 8.0), ("write", 2.0, 7.0)):
        net.immediate(
            "choose_" + kind, weight=weight, priority=2, inputs="request", outputs="want_" + kind
        )
        net.immediate(
            "begin_send_" + kind, inputs=["wait_network_" + kind, "network"], outputs="send_" + kind
        )
        net.exponential(
            "end_send_" + kind, rate=rate, inputs="send_" + kind, outputs=["network", "again"]
        )
    net.immediate(
        "begin_read", priority=3, inputs=["want_read", "database"], outputs=["do_read", "database"]
    )
    net.immediate(
        "begin_write",
        priority=4,
        inputs=["want_write", "database"],
        outputs="do_write",
        inhibitors="do_read",
    )
    net.exponential(
        "end_read", rate=10.0, servers=None, inputs="do_read", outputs="wait_network_read"
    )
    net.exponential(
        "end_write", rate=7.0, inputs="do_write", outputs=["wait_network_write", "database"]
    )
    net.immediate("rest", weight=9.0, inputs="again", outputs="think")
    net.immediate("go_on", weight=1.0, inputs="again", outputs="request")
    return net.build()


FAMILIES: Mapping[str, Callable[[int], Net]] = {
    "kanban": kanban,
    "fms": flexible_manufacturing,
    "philosophers": philosophers,
    "polling": polling,
    "courier": courier,
    "readers_writers": readers_writers,
}
"""Short name -> the nets of that kind, by size."""
