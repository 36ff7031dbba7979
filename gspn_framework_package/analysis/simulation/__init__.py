"""Discrete-event simulation of a net, or of a plan as it runs.

``runs`` is the entry point, ``estimates`` what it returns. A plan is compiled into arrays by
``plan_tables``, and played by ``plan_run`` with the inner loops of ``kernel``, which ``machine``
has in two forms, compiled and plain. ``marking_table`` lets the rates of a net race, by the rules
of ``net_rules`` or of a plan read like a net.
"""

from gspn_framework_package.analysis.simulation.estimates import Estimate, Samples, Simulation
from gspn_framework_package.analysis.simulation.runs import simulate

__all__ = ["Estimate", "Samples", "Simulation", "simulate"]
