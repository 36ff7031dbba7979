"""All that answers for a plan says the same. The campaign is ``test/campaigns/one_answer.py``."""

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from one_answer import answers, plans


@pytest.mark.long
@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@given(plan=plans())
def test_all_say_the_same(plan, tmp_path_factory):
    answers(plan, tmp_path_factory.getbasetemp() / "one_answer")
