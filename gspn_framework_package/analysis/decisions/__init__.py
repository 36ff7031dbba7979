"""Policies that are computed: from a plan to its decision problem, the best policy for an aim with
certified bounds, and back to a table in the plan's own format."""
