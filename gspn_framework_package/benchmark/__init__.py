"""Benchmarks: one command each, ratios side by side in one run, machine and versions in the output."""
