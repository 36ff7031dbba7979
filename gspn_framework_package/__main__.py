"""Entry point of ``python3 -m gspn_framework_package VERB``; needs neither a build nor ROS."""

import sys

from gspn_framework_package.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
