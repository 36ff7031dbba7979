"""Benchmarks: one command each, ratios side by side, machine and versions in the output."""

import sys

try:
    import lxml  # noqa: F401
    import numpy  # noqa: F401
    import psutil  # noqa: F401
except ModuleNotFoundError as missing:  # said here, for each benchmark is a program of its own
    sys.exit(
        "error: %s has no Python library '%s'; install it, or use the Python that ./run_tests prepares in a checkout: "
        ".workspace/venv/bin/python3" % (sys.executable, missing.name)
    )
