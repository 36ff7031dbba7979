"""``gspn fire``: fire a transition of the environment."""

from __future__ import annotations

from gspn_framework_package.cli.orders import Order

NAME = "fire"
HELP = "fire a transition of the environment"

_ORDER = Order("fire", argument="TRANSITION", help="the transition")
add_arguments = _ORDER.add_arguments
run = _ORDER.run
