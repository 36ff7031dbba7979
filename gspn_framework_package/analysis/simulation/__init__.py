"""Discrete-event simulation of a net or a plan."""

from gspn_framework_package.analysis.simulation.runs import Estimate, Simulation, simulate

__all__ = ["Estimate", "Simulation", "simulate"]
