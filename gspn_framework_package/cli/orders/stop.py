"""``gspn stop``: end the run of a team."""

from __future__ import annotations

from gspn_framework_package.cli.orders import Order

NAME = "stop"
HELP = "end the run of a team"

_ORDER = Order("stop")
add_arguments = _ORDER.add_arguments
run = _ORDER.run
