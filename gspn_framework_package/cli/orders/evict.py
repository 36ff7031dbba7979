"""``gspn evict``: take a robot out of the team as lost."""

from __future__ import annotations

from gspn_framework_package.cli.orders import Order

NAME = "evict"
HELP = "take a robot out of the team as lost"

_ORDER = Order("evict", robot="ROBOT")
add_arguments = _ORDER.add_arguments
run = _ORDER.run
