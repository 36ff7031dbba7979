"""Sweeps: the measures of a net or plan for a grid of variations.

Modules: ``sweep``, ``variation``.
"""
