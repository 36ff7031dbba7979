"""The steady state in a report, compared with that of an analysis in memory."""

import pytest


def assert_answers_of(analysis, found):
    """Assert that a report has the steady state of an analysis, which has one recurrent class."""
    measures = analysis.measures
    assert found["throughput"] == pytest.approx(measures.throughput, abs=1e-9)
    assert found["mean_tokens"] == pytest.approx(measures.mean_tokens, abs=1e-9)
    waits = measures.mean_waiting_time
    assert found["mean_waiting_time"] == pytest.approx(waits, rel=1e-7, nan_ok=True)
    for place, counts in measures.token_distribution.items():
        told = {int(n): value for n, value in found["token_distribution"][place].items()}
        # what one analysis finds to be 0 it leaves out, and another may not
        for n in {*counts, *told}:
            assert told.get(n, 0.0) == pytest.approx(counts.get(n, 0.0), abs=1e-9)
    component = max(analysis.steady.components, key=lambda part: part.probability)
    assert found["components"][0]["states"] == len(component.states)
