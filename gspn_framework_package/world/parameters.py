"""Parameters shared by the nodes of this folder."""

from __future__ import annotations

import re
from typing import List, Union

import rospy

from gspn_framework_package.formats.yaml_file import is_finite_number
from gspn_framework_package.model.errors import InputError


def robot_names(value: Union[int, str, List[str]]) -> List[str]:
    """The names of the robots from a parameter: a list, a text with commas, or a number.

    :raises InputError: there is no name, or one occurs twice.
    """
    if isinstance(value, str) and value.isdigit():
        value = int(value)
    if isinstance(value, int):
        value = ["robot_%d" % number for number in range(1, value + 1)]
    names = value.replace(",", " ").split() if isinstance(value, str) else [str(v) for v in value]
    names = [name.strip("/") for name in names]
    wrong = [name for name in names if not re.match(r"^[A-Za-z]\w*(/[A-Za-z]\w*)*$", name)]
    trouble = (
        "'%s' is not a valid name for a robot" % wrong[0]
        if wrong
        else "no robots, or one twice: %r" % (value,)
    )
    if wrong or not names or len(set(names)) != len(names):
        raise InputError(
            trouble,
            element="parameter ~robots",
            hint="give how many, or their names, e.g. robot_1,robot_2",
        )
    return names


def number_parameter(parameter: str, default: float) -> float:
    """A private parameter that is a number, 0 or more. :raises InputError: it is anything else."""
    value = rospy.get_param("~" + parameter, default)
    if not is_finite_number(value) or value < 0.0:
        raise InputError(
            "%r is not a number of at least 0" % (value,), element="parameter ~" + parameter
        )
    return float(value)
