"""``python3 -m benchmarks.faults``."""

import sys

from benchmarks.faults.main import main

if __name__ == "__main__":  # the documentation build imports every module
    sys.exit(main())
