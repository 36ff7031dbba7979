"""Benchmarks: one command each, with ratios side by side, and the machine and versions in the
output. They belong to the checkout and are not installed."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

from gspn_framework_package.model.errors import missing_library

# Reported here, since each benchmark is a separate program. They are not imported: robots import
# the load from here, and none of these.
for _library in ("lxml", "numpy", "psutil"):
    if find_spec(_library) is None:
        sys.exit("error: " + missing_library(ModuleNotFoundError(name=_library)))

_ROOT = Path(__file__).resolve().parents[1]
# the simulated teams of test/agreement
sys.path.append(str(_ROOT / "test"))
# robots that a benchmark starts run functions of this package
os.environ["PYTHONPATH"] = os.pathsep.join(
    path for path in (os.environ.get("PYTHONPATH", ""), str(_ROOT)) if path
)
