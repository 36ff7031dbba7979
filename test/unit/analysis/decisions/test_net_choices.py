"""``gspn optimise`` with a net: its immediate transitions of weight 0 are the choices."""

import json
from pathlib import Path

import pytest

from gspn_framework_package.analysis.decisions.aims import Objective, Request
from gspn_framework_package.analysis.decisions.net_choices import plan_of_choices
from gspn_framework_package.analysis.decisions.optimise import optimise
from gspn_framework_package.cli.main import main
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import RefusedError

SITES = str(Path(__file__).parents[2] / "formats" / "data" / "sites.PNPRO")
REWARDS = ["--reward", "done_near=1", "--reward", "done_far=3"]


@pytest.mark.parametrize(
    "robots, far, best", [(0, 1.0, 0.0), (1, 0.5, 2.0), (1, 1.0, 3.0), (3, 0.5, 3.5)]
)
def test_a_net_with_constants_is_optimised_and_written(tmp_path, capfd, robots, far, best):
    """The near site gives 2 a second; the far one, for one robot at a time, three times its rate."""
    written = str(tmp_path / "best.json")
    words = ["optimise", SITES, "--const", "N=%d" % robots, "--const", "far=%g" % far, *REWARDS]
    assert main([*words, "--json", "-o", written]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert answer["value"] == pytest.approx(best, rel=1e-6)
    assert answer["present_policy"]["value"] is None and answer["simulation"] is None
    assert main(["analyse", written, "--timing", "net", *REWARDS, "--json"]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert answer["steady_state"]["reward"] == pytest.approx(best)


def test_what_has_a_weight_is_drawn():
    """A choice between a sure way (1/s, worth 1) and a draw: worth 4 with probability 1/4."""
    builder = NetBuilder().place("home")  # the choice comes later
    for name in ("sure", "bet", "won", "lost"):
        builder.place(name, tokens=int(name == "sure"))
        if name != "bet":
            builder.exponential(name + "_end", rate=1.0, inputs=name, outputs="home")
    builder.immediate("take", weight=0, inputs="home", outputs="sure")
    builder.immediate("risk", weight=0, inputs="home", outputs="bet")
    builder.immediate("win", weight=1, inputs="bet", outputs="won")
    builder.immediate("lose", weight=3, inputs="bet", outputs="lost")
    plan = plan_of_choices(builder.build())
    assert plan.action_places == ("home",)
    for prize, best in ((3.0, 1.0), (8.0, 2.0)):
        aim = Objective.long_run({"sure_end": 1.0, "won_end": prize})
        report = optimise(plan, Request(aim, reading="net"), simulated=0)
        assert report.teams[0].value == pytest.approx(best, rel=1e-6)


def test_without_choices_or_with_unclear_ones_it_is_refused():
    builder = NetBuilder().place("A", tokens=1).place("B")
    builder.exponential("back", rate=1.0, inputs="B", outputs="A")
    with pytest.raises(RefusedError, match="no choice"):
        plan_of_choices(builder.build())
    builder.immediate("go", weight=0, inputs="A", outputs="B")
    builder.exponential("stay", rate=1.0, inputs="A", outputs="A")
    with pytest.raises(RefusedError, match="whose choice it is") as caught:
        plan_of_choices(builder.build())
    assert caught.value.element == "go"


def test_options_for_plans_are_refused(capfd):
    assert main(["optimise", SITES, *REWARDS, "--robots", "2"]) == 2
    assert capfd.readouterr().err.count("\n") == 1


def test_storm_computes_the_value_too(capfd):
    pytest.importorskip("stormpy")
    words = ["optimise", SITES, "--const", "N=3", *REWARDS, "--json"]
    assert main([*words, "--engine", "storm"]) == 0
    assert json.loads(capfd.readouterr().out)["storm"] == pytest.approx(3.5, rel=1e-6)
    assert main([*words, "--engine", "storm", "--discount", "0.1"]) == 2
    assert "no discounts" in capfd.readouterr().err
