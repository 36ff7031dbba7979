"""Benchmarks: one command each, with ratios side by side, and the machine and versions in the
output. They belong to the checkout and are not installed."""

import os
import sys
from pathlib import Path

from gspn_framework_package.model.errors import missing_library

try:
    import lxml  # noqa: F401
    import numpy  # noqa: F401
    import psutil  # noqa: F401
except ModuleNotFoundError as missing:  # reported here, since each benchmark is a separate program
    sys.exit("error: " + missing_library(missing))

_ROOT = Path(__file__).resolve().parents[1]
# the simulated teams of test/agreement
sys.path.append(str(_ROOT / "test"))
# robots that a benchmark starts run functions of this package
os.environ["PYTHONPATH"] = os.pathsep.join(
    path for path in (os.environ.get("PYTHONPATH", ""), str(_ROOT)) if path
)
