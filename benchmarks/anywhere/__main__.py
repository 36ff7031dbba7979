"""``python3 -m benchmarks.anywhere``."""

import sys

from benchmarks.anywhere.main import main

if __name__ == "__main__":  # the documentation build imports every module
    sys.exit(main())
