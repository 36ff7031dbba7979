"""``gspn retry``: try the failed action of a robot again."""

from __future__ import annotations

from gspn_framework_package.cli.orders import Order

NAME = "retry"
HELP = "try the failed action of a robot again"

_ORDER = Order("retry", robot="ROBOT")
add_arguments = _ORDER.add_arguments
run = _ORDER.run
