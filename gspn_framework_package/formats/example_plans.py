"""The location of the example plans that come with the package."""

from __future__ import annotations

import os

from gspn_framework_package.model.errors import UsageError


def plans_folder() -> str:
    """Return the folder of the example plans: beside this package in a checkout, or in its share
    folder once it is installed.

    :raises UsageError: there is none.
    """
    package = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    candidates = [os.path.join(os.path.dirname(package), "plans")]
    try:
        import rospkg

        share = rospkg.RosPack().get_path("gspn_framework_package")
        candidates.append(os.path.join(share, "plans"))
    except Exception:  # no ROS, or a ROS that does not know the package: look in the checkout
        pass
    for candidate in candidates:
        if os.path.isdir(candidate):
            return candidate
    raise UsageError("the example plans were not found", hint="looked in " + ", ".join(candidates))
