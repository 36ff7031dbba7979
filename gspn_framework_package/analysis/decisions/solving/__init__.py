"""Numeric methods for the decision problem of a plan. Each returns certified bounds."""
