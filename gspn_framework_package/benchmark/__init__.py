"""Benchmarks: one command each, ratios side by side, machine and versions in the output."""

import sys

from gspn_framework_package.model.errors import missing_library

try:
    import lxml  # noqa: F401
    import numpy  # noqa: F401
    import psutil  # noqa: F401
except ModuleNotFoundError as missing:  # said here, for each benchmark is a program of its own
    sys.exit("error: " + missing_library(missing))
