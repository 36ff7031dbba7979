"""The example plans that come with the package."""

from __future__ import annotations

import os
import shutil
from typing import List

from gspn_framework_package.formats.plan_file import PLAN_FILE
from gspn_framework_package.model.errors import InputError, UsageError

ALL_EXAMPLES = "all"
"""Stands for all examples in place of a name."""


def share_folder() -> str:
    """Return the folder of this package's data files where it is installed; it need not exist."""
    package = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    # PREFIX/lib/python3/dist-packages/PACKAGE
    prefix = os.path.normpath(os.path.join(package, *[os.pardir] * 4))
    return os.path.join(prefix, "share", os.path.basename(package))


def plans_folder() -> str:
    """Return the folder of the example plans: in this package if pip has installed it, beside it in
    a checkout, or in its share folder if catkin or Debian has installed it.

    :raises UsageError: the folder does not exist.
    """
    package = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    candidates = [os.path.join(package, "plans"), os.path.join(os.path.dirname(package), "plans")]
    candidates.append(os.path.join(share_folder(), "plans"))
    for candidate in candidates:
        if os.path.isdir(candidate):
            return candidate
    raise UsageError("the example plans were not found", hint="looked in " + ", ".join(candidates))


def example_names() -> List[str]:
    """Return the names of the example plans. :raises UsageError: see :func:`plans_folder`.

    >>> "patrol" in example_names()
    True
    """
    folder = plans_folder()
    return sorted(
        name for name in os.listdir(folder) if os.path.isfile(os.path.join(folder, name, PLAN_FILE))
    )


def example_folder(name: str) -> str:
    """Return the folder of an example plan. :raises UsageError: there is no such example."""
    if name not in example_names():
        raise _no_example(name, example_names())
    return os.path.join(plans_folder(), name)


def _no_example(name: str, known: List[str]) -> UsageError:
    return UsageError("there is no example '%s'" % name, hint="there are: %s" % ", ".join(known))


def copy_example(name: str, folder: str) -> List[str]:
    """Copy an example plan into a new folder.

    :param name: one of :func:`example_names`, or :data:`ALL_EXAMPLES` for a folder with a
        folder for each.
    :param folder: the folder to create.
    :returns: the names in the folder.
    :raises UsageError: there is no such example, or the folder exists.
    :raises InputError: the folder cannot be written; nothing is left behind.
    """
    names = example_names()
    if name not in (*names, ALL_EXAMPLES):
        raise _no_example(name, [*names, ALL_EXAMPLES])
    if os.path.lexists(folder):
        raise UsageError("the folder exists already", file=folder, hint="choose another folder")
    ignored = shutil.ignore_patterns("__pycache__")
    try:
        if name == ALL_EXAMPLES:
            for each in names:
                shutil.copytree(
                    os.path.join(plans_folder(), each), os.path.join(folder, each), ignore=ignored
                )
        else:
            shutil.copytree(os.path.join(plans_folder(), name), folder, ignore=ignored)
    except (OSError, shutil.Error) as error:
        shutil.rmtree(folder, ignore_errors=True)
        why = getattr(error, "strerror", None) or "not every file was copied"
        raise InputError("it cannot be written (%s)" % why, file=folder) from None
    return sorted(os.listdir(folder))
