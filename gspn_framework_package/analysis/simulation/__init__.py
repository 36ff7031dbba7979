"""Discrete-event simulation of a net, or of a plan as it runs.

``runs`` is the entry point, ``estimates`` what it returns, ``batches`` its tasks. ``kernel`` has
the inner loops, which ``machine`` has in two forms, compiled and plain; ``kernel_run`` calls them.
``plan_tables`` makes arrays of a plan for ``plan_run``, ``policy_book`` those of its policy;
``race_run`` does both for a net, and ``net_arrays`` what they have in common. A plan simulated by
the rates of its net needs the policy in every marking: ``state_cache``.

Also here: ``against``, ``against_result``, ``aimed_run``, ``paired_estimates``, ``pairs``.
"""

from gspn_framework_package.analysis.simulation.estimates import Estimate, Samples, Simulation
from gspn_framework_package.analysis.simulation.runs import (
    Asked,
    SimulationWork,
    finished,
    simulate,
)

__all__ = ["Asked", "Estimate", "Samples", "Simulation", "SimulationWork", "finished", "simulate"]
