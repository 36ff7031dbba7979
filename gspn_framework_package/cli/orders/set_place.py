"""``gspn set-place``: put a robot into a place; its action there begins."""

from __future__ import annotations

from gspn_framework_package.cli.orders import Order

NAME = "set-place"
HELP = "put a robot into a place; its action there begins"

_ORDER = Order("set_place", robot="ROBOT", argument="PLACE", help="the place")
add_arguments = _ORDER.add_arguments
run = _ORDER.run
