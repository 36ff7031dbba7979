"""Storm computes the value of a decision problem, as a check of the package's own.

Storm (Hensel et al., *Software Tools for Technology Transfer* 24, 2022) is optional: ``pip install
stormpy``.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Dict, List, Optional

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans
from gspn_framework_package.analysis.decisions.aims import Aim, Request
from gspn_framework_package.analysis.decisions.automaton import Automaton, Rewards
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import RefusedError, UsageError, how_to_install

FORMULAS = {
    Aim.LONG_RUN: 'R{"earned"}%s=? [LRA]',
    Aim.TIME_TO: 'T%s=? [F "goal"]',
    Aim.COST_TO: 'R{"earned"}%s=? [F "goal"]',
    Aim.REACH: 'P%s=? [F "goal"]',
}
"""What Storm is asked for each aim, to maximise or minimise (``max``, ``min``)."""

_WORKER = """
import sys, stormpy
model = stormpy.build_model_from_drn(sys.argv[1])
(formula,) = stormpy.parse_properties(sys.argv[2])
print(stormpy.model_checking(model, formula).get_value(model.initial_states[0]))
"""
"""Runs Storm in a separate process, which can be ended."""


def check_storm(request: Request) -> None:
    """Check that Storm is installed and can compute what is asked.

    :raises UsageError: it is not, or cannot.
    """
    if find_spec("stormpy") is None:
        raise UsageError("Storm is not there", hint=how_to_install("stormpy"))
    if request.objective.aim not in FORMULAS or request.at_least or request.uncertain:
        raise UsageError("Storm computes no discounts, --at-least or --uncertain: use --engine own")


def storm_value(
    automaton: Automaton,
    aim: Aim,
    maximise: bool,
    rewards: Optional[Rewards],
    goal: Optional[Booleans],
    allowed: Optional[Booleans],
    watch: Watch,
) -> float:
    """The best value by Storm's engine for Markov automata (relative error 1e-6).

    :param allowed: the rows to choose from; None: all.
    :raises RefusedError: Storm ends with an error.
    :raises CancelledError, LimitError: the watch ended the work.
    """
    formula = FORMULAS[aim] % ("max" if maximise else "min")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "automaton.drn")
        file.write_text(automaton_in_drn(automaton, rewards, goal, allowed), encoding="utf-8")
        begin = time.monotonic()
        with subprocess.Popen(
            [sys.executable, "-c", _WORKER, str(file), formula],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            universal_newlines=True,
        ) as process:
            try:
                output = None
                while output is None:
                    watch.step("seconds of Storm", int(time.monotonic() - begin))
                    with suppress(subprocess.TimeoutExpired):
                        output, errors = process.communicate(timeout=0.2)
            finally:
                process.kill()
    try:
        return float(output.split()[-1])
    except (IndexError, ValueError):
        said = (errors.strip() or "no message").splitlines()[-1]
        raise RefusedError("Storm has no value: %s" % said) from None


def automaton_in_drn(
    automaton: Automaton,
    rewards: Optional[Rewards],
    goal: Optional[Booleans],
    allowed: Optional[Booleans] = None,
) -> str:
    """A Markov automaton in Storm's format DRN. Its rewards are called ``earned``, its goal
    ``goal``. A tangible state without arcs gets an arc to itself. Only the ``allowed`` rows are
    written.

    Storm knows rewards of states (per second) and of choices only: what the arcs of a choice earn
    is averaged over them; in a tangible state it is earned per second.

    :raises RefusedError: there are several initial states.
    """
    if len(automaton.initial) > 1:
        raise RefusedError("Storm begins in one state, and this problem in several")
    states, rows = len(automaton), len(automaton.choices)
    impulse = np.zeros(len(automaton.values)) if rewards is None else rewards.impulse
    rate_rewards = np.zeros(states) if rewards is None else rewards.rate
    weights = automaton.values * np.asarray(impulse, dtype=np.float64)
    earned = np.bincount(automaton.arc_rows, weights=weights, minlength=rows)
    written = np.ones(rows, dtype=bool) if allowed is None else allowed
    lines: List[str] = ["@type: Markov Automaton", "@parameters", "", "@reward_models", "earned"]
    lines += ["@nr_states", str(states)]
    lines += ["@nr_choices", str(int(written.sum())), "@model"]
    for state in range(states):
        first, last = int(automaton.rows[state]), int(automaton.rows[state + 1])
        tangible = bool(automaton.tangible[state])
        labels = [" init"] if state == automaton.initial[0][0] else []
        if goal is not None and goal[state]:
            labels.append(" goal")
        rate = float(automaton.exit_rates[first]) if tangible else 0.0
        per_second = float(rate_rewards[state]) + float(earned[first]) if tangible else 0.0
        lines.append(
            "state %d !%r [%r]%s" % (state, rate or float(tangible), per_second, "".join(labels))
        )
        for number, row in enumerate(np.flatnonzero(written[first:last]) + first):
            lines.append("\taction %d [%r]" % (number, 0.0 if tangible else float(earned[row])))
            arcs = slice(int(automaton.arcs[row]), int(automaton.arcs[row + 1]))
            into: Dict[int, float] = {}
            for target, value in zip(automaton.targets[arcs], automaton.values[arcs]):
                into[int(target)] = into.get(int(target), 0.0) + float(value) / (rate or 1.0)
            for target, value in sorted((into or {state: 1.0}).items()):
                lines.append("\t\t%d : %r" % (target, value))
    return "\n".join(lines) + "\n"
