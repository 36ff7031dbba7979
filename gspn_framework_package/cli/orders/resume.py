"""``gspn resume``: end a pause of the team, or of one robot."""

from __future__ import annotations

from gspn_framework_package.cli.orders import Order

NAME = "resume"
HELP = "end a pause of the team, or of one robot"

_ORDER = Order("resume", robot="[ROBOT]")
add_arguments = _ORDER.add_arguments
run = _ORDER.run
