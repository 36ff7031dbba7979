"""``python3 -m gspn_framework_package.benchmark.netns``."""

import sys

from gspn_framework_package.benchmark.netns.main import main

sys.exit(main())
