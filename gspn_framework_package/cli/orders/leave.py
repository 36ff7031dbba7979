"""``gspn leave``: have a robot leave the team, with its token."""

from __future__ import annotations

from gspn_framework_package.cli.orders import Order

NAME = "leave"
HELP = "have a robot leave the team, with its token"

_ORDER = Order("leave", robot="ROBOT")
add_arguments = _ORDER.add_arguments
run = _ORDER.run
