"""Nets and plans in a few lines of Python: load or build one, and ask it.

>>> import gspn
>>> net = (gspn.Net("machine").place("up", tokens=1).place("down")
...        .exponential("fail", rate=1.0, inputs="up", outputs="down")
...        .exponential("repair", rate=3.0, inputs="down", outputs="up"))
>>> net
<Net machine: 2 places, 2 transitions, 4 arcs>
>>> round(net.steady().mean_tokens["up"], 6)
0.75

This is the stable interface of the package: its names are those of ``docs/python.md``, and a test
compares them with a list. Each is a thin layer over ``gspn_framework_package``, whose modules may
change with any version. Times are in seconds, rates in 1/s. Errors are those of
:class:`GspnError`; the message says what is wrong, where, and what to do.

Nothing is imported before it is used. Modules: ``examples``, ``results``, ``running``,
``subjects``, ``tables``, ``teams``.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any, List

from gspn_framework_package import __version__

if TYPE_CHECKING:
    from gspn.results import Picture, Result
    from gspn.subjects import Net, Plan, example, load, new
    from gspn.teams import Team
    from gspn_framework_package.formats.example_plans import example_names
    from gspn_framework_package.model.errors import (
        GspnError,
        InputError,
        LimitError,
        RefusedError,
    )

__all__ = [
    "GspnError",
    "InputError",
    "LimitError",
    "Net",
    "Picture",
    "Plan",
    "RefusedError",
    "Result",
    "Team",
    "__version__",
    "example",
    "example_names",
    "load",
    "new",
]

_HOMES = {
    "gspn.subjects": ("Net", "Plan", "example", "load", "new"),
    "gspn.results": ("Picture", "Result"),
    "gspn.teams": ("Team",),
    "gspn_framework_package.formats.example_plans": ("example_names",),
    "gspn_framework_package.model.errors": (
        "GspnError",
        "InputError",
        "LimitError",
        "RefusedError",
    ),
}


def __getattr__(name: str) -> Any:
    """Import what is asked for the first time."""
    for module, names in _HOMES.items():
        if name in names:
            found = getattr(importlib.import_module(module), name)
            globals()[name] = found
            return found
    raise AttributeError("module 'gspn' has no attribute '%s'" % name)


def __dir__() -> List[str]:
    return list(__all__)
