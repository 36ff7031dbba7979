"""The reachable markings of a net, the engines that find them, and the properties of their
graph.

Modules: ``coverability``, ``exploration``, ``marking_store``, ``numba_engine``, ``numpy_engine``,
``packing``, ``properties``, ``rated_graph``, ``space``, ``sparse_engine``, ``window``.
"""

from gspn_framework_package.analysis.state_space.space import (
    ENGINES,
    StateSpace,
    WitnessStep,
    explore,
)

__all__ = ["ENGINES", "StateSpace", "WitnessStep", "explore"]
