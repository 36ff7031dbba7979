"""``python3 -m benchmarks.netns``."""

import sys

from benchmarks.netns.main import main

if __name__ == "__main__":  # the documentation build imports every module
    sys.exit(main())
