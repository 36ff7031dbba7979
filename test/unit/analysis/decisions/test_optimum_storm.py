"""Storm agrees with the optimum of generated automata for every aim that it knows, to 1e-6."""

import math
import os
import tempfile

import numpy as np
import pytest
from generated_automata import automata, rewarded
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from gspn_framework_package.analysis.decisions.aims import Aim
from gspn_framework_package.analysis.decisions.solving import optimum
from gspn_framework_package.analysis.decisions.storm import FORMULAS, automaton_in_drn
from gspn_framework_package.analysis.graph import longest_levels
from gspn_framework_package.model.errors import LimitError, RefusedError

stormpy = pytest.importorskip(
    "stormpy", reason="stormpy has no wheel for this Python; it is an oracle of the tests only"
)


EXAMPLES = int(os.environ.get("GSPN_STORM_EXAMPLES", "40"))
relaxed = settings(
    max_examples=EXAMPLES, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck)
)


def storms(automaton, rewards, goal, aim, maximise):
    with tempfile.TemporaryDirectory() as folder:
        file = os.path.join(folder, "automaton.drn")
        with open(file, "w", encoding="utf-8") as output:
            output.write(automaton_in_drn(automaton, rewards, goal))
        model = stormpy.build_model_from_drn(file)
    text = FORMULAS[aim] % ("max" if maximise else "min")
    (formula,) = stormpy.parse_properties(text)
    return float(stormpy.model_checking(model, formula).get_value(model.initial_states[0]))


@relaxed
@given(automata(most=12), st.sampled_from(sorted(FORMULAS, key=str)), st.booleans())
def test_storm_agrees(problem, aim, maximise):
    automaton, rewards, goal = problem
    assume(goal.any() or aim is Aim.LONG_RUN)  # Storm knows no label that no state has
    # where immediate transitions can fire in a cycle, Storm lets them, or does not come to an end
    vanishing = ~automaton.tangible
    sources = automaton.row_states[automaton.arc_rows]
    inner = vanishing[sources] & vanishing[automaton.targets]
    assume(longest_levels(len(automaton), sources[inner], automaton.targets[inner])[1])
    rewards = rewarded(automaton, np.abs(rewards.rate), np.abs(rewards.impulse))
    try:
        solved = optimum(automaton, aim, rewards, goal=goal, maximise=maximise, width=1e-9)
    except LimitError:
        raise
    except RefusedError as refused:
        assert "infinite" in str(refused)
        assert storms(automaton, rewards, goal, aim, maximise) == math.inf
        return
    wanted = storms(automaton, rewards, goal, aim, maximise)
    # Storm is asked for 1e-6 of the value
    assert solved.lower == pytest.approx(wanted, rel=2e-6, abs=2e-6)
    assert solved.upper == pytest.approx(wanted, rel=2e-6, abs=2e-6)
