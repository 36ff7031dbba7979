"""Quantiles are those of SciPy's distributions; and the commands start without these."""

import subprocess
import sys

import pytest
from scipy import stats

from gspn_framework_package.analysis import quantiles


@pytest.mark.parametrize("probability", [1e-9, 0.025, 0.5, 0.8, 0.995])
def test_quantiles_are_those_of_the_distributions(probability):
    assert quantiles.normal_quantile(probability) == pytest.approx(stats.norm.ppf(probability))
    for freedom in (1, 2, 17, 1500):
        assert quantiles.student(probability, freedom) == pytest.approx(
            stats.t.ppf(probability, freedom)
        )
        value = quantiles.chi_squared(probability, freedom)
        assert value == pytest.approx(stats.chi2.isf(probability, freedom))
        assert quantiles.chi_squared_above(value, freedom) == pytest.approx(probability)


@pytest.mark.long
def test_no_verb_imports_the_distributions_of_scipy_before_it_needs_them():
    verbs = ("analyse", "check", "compare", "fit", "optimise", "simulate", "verify")
    program = "".join("import gspn_framework_package.cli.%s\n" % verb for verb in verbs)
    subprocess.run(
        [sys.executable, "-c", program + "import sys\nassert 'scipy.stats' not in sys.modules"],
        check=True,
    )
