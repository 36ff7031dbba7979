"""Nets of decisions to compare with Storm: robots that clean rooms, deliver parcels, or meet.

Choices are immediate transitions of weight 0; one with a weight is chance's. Rates are per second.
"""

from __future__ import annotations

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Net


def rooms(robots: int) -> Net:
    """Robots clean three rooms, each of which gets dirty by and by, up to three heaps: a robot
    chooses a room that is not full, or rests."""
    builder = NetBuilder().place("free", tokens=robots).place("resting")
    builder.immediate("rest", weight=0, inputs="free", outputs="resting")
    builder.exponential("rested", rate=0.5, servers=None, inputs="resting", outputs="free")
    for room, (dirt, clean) in enumerate(((0.3, 0.5), (0.2, 0.3), (0.1, 0.2))):
        going, cleaning = "going_%d" % room, "cleaning_%d" % room
        tidy, dirty, space = "tidy_%d" % room, "dirty_%d" % room, "space_%d" % room
        builder.place(going).place(cleaning).place(tidy, tokens=3).place(dirty)
        builder.place(space, tokens=min(robots, 2))
        builder.exponential("soil_%d" % room, rate=dirt, inputs=tidy, outputs=dirty)
        builder.immediate("go_%d" % room, weight=0, inputs=["free", space], outputs=going)
        builder.exponential(
            "arrive_%d" % room, rate=0.4, servers=None, inputs=going, outputs=cleaning
        )
        builder.exponential(
            "clean_%d" % room,
            rate=clean,
            servers=None,
            inputs=[cleaning, dirty],
            outputs=["free", space, tidy],
        )
        builder.exponential(
            "leave_%d" % room,
            rate=0.1,
            servers=None,
            inputs=cleaning,
            outputs=["free", space],
        )
    return builder.build()


def delivery(robots: int, stations: int, room: int) -> Net:
    """Parcels come to stations, the more the farther away, until there is no room. A robot chooses
    a station, takes a parcel there, or gives up, and brings it home."""
    builder = NetBuilder().place("idle", tokens=robots)
    for station in range(stations):
        space, parcel = "space_%d" % station, "parcel_%d" % station
        going, there = "going_%d" % station, "at_%d" % station
        carrying, way = "carrying_%d" % station, 0.2 / (station + 1)
        builder.place(space, tokens=room).place(parcel).place(going).place(there).place(carrying)
        builder.exponential("come_%d" % station, 0.05 * (station + 1), inputs=space, outputs=parcel)
        builder.immediate("go_%d" % station, weight=0, inputs="idle", outputs=going)
        builder.exponential("arrive_%d" % station, way, None, inputs=going, outputs=there)
        builder.exponential(
            "pick_%d" % station, 0.5, inputs=[there, parcel], outputs=[carrying, space]
        )
        builder.exponential("leave_%d" % station, 0.1, None, inputs=there, outputs="idle")
        builder.exponential("bring_%d" % station, way, None, inputs=carrying, outputs="idle")
    return builder.build()


def rendezvous(robots: int, points: int, jobs: int) -> Net:
    """Two robots that meet at a point do one of the jobs that are open there. A robot chooses the
    point, and gives up if nobody comes."""
    builder = NetBuilder().place("free", tokens=robots)
    for point in range(points):
        open_, closed, going = "open_%d" % point, "closed_%d" % point, "going_%d" % point
        waiting, pair = "waiting_%d" % point, "pair_%d" % point
        builder.place(open_, tokens=jobs).place(closed).place(going).place(waiting).place(pair)
        builder.immediate("choose_%d" % point, weight=0, inputs="free", outputs=going)
        builder.exponential(
            "arrive_%d" % point, 0.3 / (point + 1), None, inputs=going, outputs=waiting
        )
        builder.immediate("meet_%d" % point, inputs={waiting: 2, open_: 1}, outputs=pair)
        builder.exponential(
            "work_%d" % point, 0.25, None, inputs=pair, outputs={"free": 2, closed: 1}
        )
        builder.exponential("give_up_%d" % point, 0.02, None, inputs=waiting, outputs="free")
        builder.exponential("reopen_%d" % point, 0.05 * (point + 1), inputs=closed, outputs=open_)
    return builder.build()
