"""Benchmarks: one command each, ratios side by side, machine and versions in the output."""
