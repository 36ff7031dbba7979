"""The aim of a policy on the command line."""

from __future__ import annotations

import argparse

import pytest

from gspn_framework_package.analysis.decisions.aims import Aim, Objective
from gspn_framework_package.cli.aims import AIM_OPTIONS, objective_of
from gspn_framework_package.cli.options import add_options
from gspn_framework_package.model.errors import UsageError


def read(*words: str) -> Objective:
    parser = argparse.ArgumentParser()
    add_options(parser, AIM_OPTIONS)
    return objective_of(parser.parse_args(words))


def test_each_aim_can_be_asked_for():
    assert read("--reward", "go=2", "--reward", "a=b=-1") == Objective.long_run(
        {"go": 2.0, "a=b": -1.0}
    )
    assert read("--mean-time-to", "a == 1") == Objective.time_to("a == 1")
    assert read("--cost-to", "a == 1", "--reward", "go=2") == Objective.cost_to(
        "a == 1", {"go": 2.0}
    )
    assert read("--reach", "a == 1") == Objective.reach("a == 1")
    assert read("--reward", "go=2", "--discount", "0.5") == Objective.discounted({"go": 2.0}, 0.5)
    lowest = read("--reward", "go=2", "--minimise")
    assert lowest.aim is Aim.LONG_RUN
    assert not lowest.maximise


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "no aim is given"),
        (["--reward", "go"], "write NAME=NUMBER"),
        (["--reward", "go=fast"], "write NAME=NUMBER"),
        (["--reward", "go=1", "--reward", "go=2"], "names 'go' twice"),
        (["--reach", "a", "--mean-time-to", "b"], "exclude each other"),
        (["--reach", "a", "--discount", "1"], "exclude each other"),
        (["--reach", "a", "--reward", "go=1"], "has no rewards"),
        (["--mean-time-to", "a", "--minimise"], "minimised in any case"),
    ],
)
def test_what_makes_no_sense_is_refused(words, message):
    with pytest.raises(UsageError, match=message):
        read(*words)
