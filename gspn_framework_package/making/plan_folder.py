"""Writes a new plan's folder: all of its files, or nothing."""

from __future__ import annotations

import os
import shutil
from typing import Any, Dict, List, Mapping, Optional, Sequence

from gspn_framework_package.formats import encode_net, format_named
from gspn_framework_package.formats.json_file import json_text
from gspn_framework_package.formats.plan_file import PLAN_FILE, read_plan
from gspn_framework_package.model.errors import InputError, UsageError
from gspn_framework_package.model.net import Net

NET_FILE = "net.xml"
"""File name of a new plan's net, which PIPE can also open."""

POLICY_FILE = "policy.json"
"""File name of a new plan's policy."""


def write_plan_folder(
    folder: str,
    net: Net,
    plan: Mapping[str, Any],
    policy: Optional[Mapping[str, Any]],
    files: Mapping[str, str],
    plans: Sequence[str] = (PLAN_FILE,),
) -> List[str]:
    """Write a plan into a new folder, and read it once to check that it is valid.

    :param plan: the object of the plan file, without ``net`` and ``policy``.
    :param files: name -> text of further files.
    :param plans: the plan files among them, which are checked.
    :returns: the names of the files in the folder.
    :raises UsageError: the folder exists.
    :raises GspnError: it is not a plan.
    :raises InputError: it cannot be written; nothing is left behind.
    """
    refuse_existing_folder(folder)
    head = {key: plan[key] for key in ("plan", "description") if key in plan}
    whole: Dict[str, Any] = {**head, "net": NET_FILE}
    if policy is not None:
        whole["policy"] = POLICY_FILE
    whole.update((key, value) for key, value in plan.items() if key not in head)
    contents: Dict[str, bytes] = {
        PLAN_FILE: json_text(whole).encode(),
        NET_FILE: encode_net(net, format_named("pipe"))[0],
    }
    if policy is not None:
        contents[POLICY_FILE] = json_text(policy).encode()
    contents.update((name, text.encode()) for name, text in files.items())
    try:
        os.makedirs(folder)
    except OSError as error:
        raise InputError("cannot create the folder (%s)" % error.strerror, file=folder) from None
    try:
        for name, content in contents.items():
            os.makedirs(os.path.dirname(os.path.join(folder, name)), exist_ok=True)
            with open(os.path.join(folder, name), "wb") as file:
                file.write(content)
        for name in plans:
            read_plan(os.path.join(folder, name))
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise InputError("it cannot be written (%s)" % error.strerror, file=folder) from None
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return list(contents)


def refuse_existing_folder(folder: str) -> None:
    """Refuse the folder of a new plan. :raises UsageError: it exists."""
    if os.path.lexists(folder):
        raise UsageError(
            "the folder exists already",
            file=folder,
            hint="choose the name of a new folder for the plan",
        )
