"""Tests of plans: run a plan in virtual time under the control of a test, and examine what it does.

>>> from gspn_framework_package.model.builder import NetBuilder
>>> from gspn_framework_package.model.action import FunctionAction
>>> from gspn_framework_package.model.plan import Plan, RobotSpec
>>> net = (NetBuilder().place("Fetch", 1).place("Done")
...        .exponential("got_it", rate=1, inputs="Fetch", outputs="Done").build())
>>> plan = Plan(net, actions={"Fetch": FunctionAction("acts.fetch", "fetch"), "Done": None},
...             robots=(RobotSpec("robot_1", "Fetch"),))
>>> run = Scenario(plan)
>>> run.action("Fetch", seconds=30.0, result="got_it")
>>> run.advance(29.0)
>>> run.place("robot_1")
'Fetch'
>>> run.advance(1.0)
>>> run.fired, run.ended.finished
(['got_it'], True)

See ``docs/testing_plans.md`` for everything else.

Modules: ``coverage``, ``outcomes``, ``scenario``, ``seen``, ``virtual_wait``.
"""

from gspn_framework_package.testing.coverage import Coverage
from gspn_framework_package.testing.scenario import Scenario
from gspn_framework_package.testing.seen import ActionAttempt, FiredAt

__all__ = ["ActionAttempt", "Coverage", "FiredAt", "Scenario"]
