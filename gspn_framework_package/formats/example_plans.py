"""Where the example plans are that come with the package."""

from __future__ import annotations

import os

from gspn_framework_package.model.errors import UsageError


def plans_folder() -> str:
    """The folder of the example plans: beside this package in a checkout, in its share folder once
    it is installed.

    :raises UsageError: there is none.
    """
    package = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    candidates = [os.path.join(os.path.dirname(package), "plans")]
    try:
        import rospkg

        share = rospkg.RosPack().get_path("gspn_framework_package")
        candidates.append(os.path.join(share, "plans"))
    except Exception:  # no ROS, or a ROS that does not know the package: there is the checkout
        pass
    for candidate in candidates:
        if os.path.isdir(candidate):
            return candidate
    raise UsageError("the example plans were not found", hint="looked in " + ", ".join(candidates))
