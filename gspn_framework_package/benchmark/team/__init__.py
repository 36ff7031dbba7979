"""A simulated team: real replicas on a simulated network, with faults, under a seed."""
