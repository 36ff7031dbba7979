"""``python3 -m gspn_framework_package.benchmark.anywhere``."""

import sys

from gspn_framework_package.benchmark.anywhere.main import main

if __name__ == "__main__":  # the documentation build imports every module
    sys.exit(main())
