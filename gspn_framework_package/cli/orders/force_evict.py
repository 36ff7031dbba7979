"""``gspn force-evict``: the same without a quorum: you assert that the robot is switched off."""

from __future__ import annotations

from gspn_framework_package.cli.orders import Order

NAME = "force-evict"
HELP = "the same without a quorum: you assert that the robot is switched off"

_ORDER = Order("force_evict", robot="ROBOT")
add_arguments = _ORDER.add_arguments
run = _ORDER.run
