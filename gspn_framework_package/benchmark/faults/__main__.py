"""``python3 -m gspn_framework_package.benchmark.faults``."""

import sys

from gspn_framework_package.benchmark.faults.main import main

if __name__ == "__main__":  # the documentation build imports every module
    sys.exit(main())
