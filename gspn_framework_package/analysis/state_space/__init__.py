"""The reachable markings of a net, the engines that find them, and the properties of their
graph."""

from gspn_framework_package.analysis.state_space.space import (
    ENGINES,
    StateSpace,
    WitnessStep,
    explore,
)

__all__ = ["ENGINES", "StateSpace", "WitnessStep", "explore"]
