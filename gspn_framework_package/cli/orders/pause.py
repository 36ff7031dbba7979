"""``gspn pause``: let nothing fire, or a robot join no firing, until resume."""

from __future__ import annotations

from gspn_framework_package.cli.orders import Order

NAME = "pause"
HELP = "let nothing fire, or a robot join no firing, until resume"

_ORDER = Order("pause", robot="[ROBOT]")
add_arguments = _ORDER.add_arguments
run = _ORDER.run
