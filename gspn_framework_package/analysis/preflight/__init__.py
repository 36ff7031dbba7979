"""The check of a plan before any robot moves: names, structure, markings, servers.

Modules: ``check_plan``, ``markings``, ``mending``, ``names``, ``reacting``, ``report``,
``structure``, ``while_running``.
"""

from gspn_framework_package.analysis.preflight.check_plan import (
    MARKING_LIMIT,
    PROOF_SECONDS,
    ServerProbe,
    check,
)

__all__ = ["MARKING_LIMIT", "PROOF_SECONDS", "ServerProbe", "check"]
