"""Nets and plans, and the questions that can be asked about them."""

# In one piece: a net and a plan share most questions, and each question is a docstring with an
# example around a few lines.
from __future__ import annotations

import json
import os
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from gspn import results
from gspn.results import Result
from gspn.tables import Records
from gspn_framework_package.formats import plan_file
from gspn_framework_package.model.builder import ArcEnds, NetBuilder
from gspn_framework_package.model.errors import GspnError, UsageError
from gspn_framework_package.model.net import Net as ModelNet
from gspn_framework_package.model.plan import Plan as ModelPlan

if TYPE_CHECKING:
    from gspn_framework_package.analysis.analyse import Analysis
    from gspn_framework_package.analysis.decisions.report import Report
    from gspn_framework_package.cli.fit import Learned
    from gspn_framework_package.cli.progress import ProgressLine

Texts = Union[str, Iterable[str]]
"""One text, or several."""


class _Subject:
    """What a net and a plan can both be asked."""

    def __init__(self, subject: Union[ModelNet, ModelPlan], notes: Sequence[str] = ()) -> None:
        self._subject = subject
        self.notes: Tuple[str, ...] = tuple(notes)
        """Remarks on how it was read."""

    @property
    def _net(self) -> ModelNet:
        return self._subject.net if isinstance(self._subject, ModelPlan) else self._subject

    @property
    def name(self) -> str:
        """Its name.

        >>> import gspn
        >>> gspn.example("measure").name
        'measure'
        """
        return self._subject.name

    @property
    def places(self) -> Tuple[str, ...]:
        """The names of its places.

        >>> import gspn
        >>> gspn.example("measure").places
        ('P1', 'P2', 'P3', 'P4', 'P5')
        """
        return tuple(place.name for place in self._net.places)

    @property
    def transitions(self) -> Tuple[str, ...]:
        """The names of its transitions.

        >>> import gspn
        >>> gspn.example("measure").transitions
        ('T1', 'T2', 'T3', 'T4', 'T5', 'T6')
        """
        return tuple(transition.name for transition in self._net.transitions)

    @cached_property
    def _analysis(self) -> Analysis:
        from gspn_framework_package.analysis.analyse import Analysis

        return Analysis(self._subject)

    def states(self, limit: Optional[int] = None) -> results.StatesResult:
        """Explore the reachable markings; of a plan, those that its policy allows.

        :param limit: the most markings to visit; None: two million.

        >>> import gspn
        >>> states = gspn.example("rendezvous").states()
        >>> states.number, states.deadlocks, states.bounded
        (166, 0, True)
        """
        from gspn_framework_package.analysis.analyse import Analysis
        from gspn_framework_package.analysis.report import Questions, report

        analysis = self._analysis if limit is None else Analysis(self._subject, limit=limit)
        return results.StatesResult(report(analysis, Questions(structure=False, timing=False)))

    def steady(self, reward: Optional[Mapping[str, float]] = None) -> results.SteadyResult:
        """Compute the long run: mean tokens and throughput.

        :param reward: place -> reward per token and second, or transition -> reward per firing.
        :raises LimitError: there are too many markings.
        :raises RefusedError: there is no Markov chain, for example because nobody decides a choice.
        :raises InputError: a name is not in the net.

        >>> import gspn
        >>> steady = gspn.example("measure").steady(reward={"T3": 10.0})
        >>> round(steady.throughput["T3"], 6), round(steady.reward, 5)
        (0.215716, 2.15716)
        """

        measures, worth = self._analysis.measures, None
        if reward is not None:
            in_places = {n: r for n, r in reward.items() if n in self._net.place_index}
            of_firings = {n: r for n, r in reward.items() if n not in in_places}
            worth = measures.reward(in_places, of_firings)
        return results.SteadyResult(measures, worth)

    def transient(self, times: Union[float, Iterable[float]]) -> results.TransientResult:
        """Compute mean tokens and throughput at given times.

        :param times: one time or several (s), at least 0.
        :raises LimitError: there are too many markings.
        :raises RefusedError: there is no Markov chain.

        >>> import gspn
        >>> found = gspn.example("measure").transient([0.0, 1.0])
        >>> [round(tokens["P5"], 4) for tokens in found.mean_tokens]
        [1.0, 0.8236]
        """

        asked = [times] if isinstance(times, (int, float)) else list(times)
        return results.TransientResult(self._analysis.at(_times(asked)))

    def passage(self, condition: str, within: Iterable[float] = ()) -> results.PassageResult:
        """Compute when a condition on the marking first holds.

        :param condition: such as ``"'Check L1' >= 2 and done == 0"``, or ``"deadlock"``.
        :param within: times (s) until which to give the probability.
        :raises InputError: the condition cannot be read, or names what the net has not.
        :raises LimitError: there are too many markings.

        >>> import gspn
        >>> found = gspn.example("measure").passage("P4 == 1", within=[10.0])
        >>> round(found.mean_time, 4), round(found.within[10.0], 4)
        (4.2647, 0.9057)
        """

        times = _times(within)
        return results.PassageResult(
            condition, times, self._analysis.first_passage(condition, times)
        )

    def prove(
        self,
        *,
        never: Texts = (),
        always: Texts = (),
        apart: Texts = (),
        never_fires: Texts = (),
        at_most: Texts = (),
        returns: Texts = (),
        ends: bool = False,
        moves: bool = False,
        seconds: float = 10.0,
        limit: int = 200_000,
    ) -> results.ProofResult:
        """Decide questions about all markings, with proofs where the answer is yes. Without a
        question: whether no dead marking can be reached and, of a plan, none without a policy row.

        :param never: conditions that never hold.
        :param always: conditions that always hold.
        :param apart: patterns of names, such as ``"At_*"``: no such place ever has two tokens.
        :param never_fires: transitions that never fire.
        :param at_most: patterns of names with the most tokens, such as ``"At_*=2"``.
        :param returns: conditions that can be reached from every marking.
        :param ends: whether a plan can end from every marking.
        :param moves: whether every robot that is not at an end can move again, from every marking.
        :param seconds: time for each question (s).
        :param limit: the most markings to visit for each.
        :raises InputError: a condition cannot be read, or a name is not in the net.

        >>> import gspn
        >>> gspn.example("measure").prove(never="P1 + P2 + P4 + P5 >= 3").proven
        True
        """
        from gspn_framework_package.cli.check import decide_all
        from gspn_framework_package.cli.proofs import questions_about

        questions = questions_about(
            self._subject,
            never=_texts(never),
            always=_texts(always),
            apart=_texts(apart),
            never_fires=_texts(never_fires),
            at_most=_texts(at_most),
            returns=_texts(returns),
            ends=ends,
            moves=moves,
            general=not any(
                (never, always, apart, never_fires, at_most, returns, ends, moves),
            ),
        )
        with _progress() as progress:
            answers = decide_all(
                self._subject,
                questions,
                seconds=seconds,
                limit=limit,
                standalone=False,
                progress=progress,
            )
        return results.ProofResult(answers)

    def query(self, query: str) -> results.QueryResult:
        """Answer a temporal query in the language of PRISM's properties.

        :param query: such as ``"P=? [ F<=10 done >= 2 ]"``, ``"S=? [ busy == 1 ]"`` or
            ``"AG EF home == 1"``; times are in seconds.
        :raises InputError: the query cannot be read, or an operator in it is not supported.

        >>> import gspn
        >>> found = gspn.example("measure").query("P=? [ F<=10 P3 >= 5 ]")
        >>> round(found.value, 6), found.interval[1] - found.interval[0] < 1e-9
        (0.999785, True)
        >>> gspn.example("measure").query("AG P1 <= 2").holds
        True
        """
        from gspn_framework_package.analysis.queries.answers import answer_query

        return results.QueryResult(answer_query(self._analysis, query))

    def simulate(
        self,
        time: float = float("inf"),
        *,
        until: Optional[str] = None,
        replications: Optional[int] = None,
        precision: Optional[float] = None,
        warmup: float = 0.0,
        seed: int = 0,
        confidence: float = 0.95,
    ) -> results.SimulationResult:
        """Simulate many runs; those of a plan follow its policy, with its durations.

        :param time: length of a run (s).
        :param until: a condition that ends a run.
        :param replications: number of runs (1000); with ``precision``, the most.
        :param precision: stop when the half widths are at most this fraction of the means.
        :param warmup: time (s) at the start of a run that the means leave out.
        :param seed: the same seed gives the same result.
        :param confidence: level of the intervals.
        :raises InputError: a number is invalid, or neither ``time`` nor ``until`` is given.
        :raises RefusedError: nobody decides a choice, or a run neither ends nor goes on.

        >>> import gspn
        >>> found = gspn.example("measure").simulate(100.0, replications=50)
        >>> mean, half_width = found.throughput["T1"]
        >>> abs(mean - 1.0786) < 0.1
        True
        """
        from gspn_framework_package.analysis.simulation import simulate

        with _progress() as progress:
            found = simulate(
                self._subject,
                time=time,
                until=until,
                replications=replications,
                precision=precision,
                warmup=warmup,
                seed=seed,
                confidence=confidence,
                progress=progress,
            )
        return results.SimulationResult(found)

    def draw(self, what: str = "net", limit: int = 500) -> results.Picture:
        """Draw it.

        :param what: ``net``, its ``coverability`` tree or its Markov ``chain``.
        :param limit: the most markings to draw.
        :raises InputError: there is no such drawing, or Graphviz is not installed.
        :raises LimitError: there are more markings.

        >>> import gspn
        >>> gspn.example("measure").draw()
        <Picture: the net of measure>
        """
        from gspn_framework_package.cli.draw import DRAWINGS, graph_of
        from gspn_framework_package.formats.dot import IMAGE_FORMATS, render

        _check_choice(what, DRAWINGS)
        text = graph_of(self._subject, what, limit).text()

        def drawn(image: str) -> bytes:
            return text.encode("utf-8") if image == "dot" else render(text, image)

        about = "the %s of %s" % (what, self.name)
        return results.Picture(about, drawn, [*IMAGE_FORMATS, "dot"])

    def plot(
        self,
        what: str = "tokens",
        *,
        time: Optional[float] = None,
        only: Texts = (),
        condition: Optional[str] = None,
        points: int = 60,
    ) -> results.Picture:
        """Plot what the analysis computes.

        :param what: ``tokens`` or ``throughput`` over time, the ``distribution`` of tokens in the
            long run, or the probability of a ``passage`` over time.
        :param time: end of the time axis (s); None: until the net has settled.
        :param only: the places or transitions to plot; none: all.
        :param condition: of a ``passage``: the condition to reach.
        :param points: number of points in time.
        :raises InputError: there is no such plot or name, or matplotlib is not installed.
        :raises LimitError: there are too many markings.

        >>> import gspn
        >>> gspn.example("measure").plot("passage", condition="P4 == 1", time=20.0)
        <Picture: the passage of measure>
        """

        try:
            from gspn_framework_package.cli.plot import PLOTS, figure_of
        except ModuleNotFoundError as error:
            raise UsageError("a plot needs %s, which is not installed" % error.name) from None
        _check_choice(what, PLOTS)
        if (what == "passage") != (condition is not None):
            raise UsageError("the plot 'passage' and a condition belong together")
        names = list(_texts(only))
        figure = figure_of(
            self._analysis, what, time=time, points=points, only=names, condition=condition
        )
        return results.picture_of_figure("the %s of %s" % (what, self.name), figure)

    def _repr_svg_(self) -> Optional[str]:
        try:
            return self.draw().svg
        except UsageError:  # no Graphviz: the notebook shows the text
            return None


class Net(_Subject):
    """A net. Each building step returns a new net; the old one stays as it was.

    :param name: its name.

    >>> import gspn
    >>> net = (gspn.Net("machine").place("up", tokens=1).place("down")
    ...        .exponential("fail", rate=1.0, inputs="up", outputs="down")
    ...        .exponential("repair", rate=3.0, inputs="down", outputs="up"))
    >>> net.states().number
    2
    """

    _subject: ModelNet

    def __init__(self, name: str = "") -> None:
        super().__init__(NetBuilder(name).build())

    @classmethod
    def _of(cls, model: ModelNet, notes: Sequence[str] = ()) -> Net:
        net = cls()
        _Subject.__init__(net, model, notes)
        return net

    def place(self, name: str, tokens: int = 0, capacity: Optional[int] = None) -> Net:
        """Return the net with another place.

        :param name: its name.
        :param tokens: its tokens in the initial marking.
        :param capacity: the most tokens that it takes; None: any number.
        :raises InputError: the name is taken, or a number is invalid.

        >>> import gspn
        >>> gspn.Net("store").place("parts", tokens=3, capacity=5)
        <Net store: 1 places, 0 transitions, 0 arcs>
        """
        return self._with(lambda net: net.place(name, tokens, capacity))

    def immediate(
        self,
        name: str,
        inputs: ArcEnds = (),
        outputs: ArcEnds = (),
        *,
        weight: Union[float, str] = 1.0,
        priority: int = 1,
        inhibitors: ArcEnds = (),
    ) -> Net:
        """Return the net with another immediate transition and its arcs.

        :param name: its name.
        :param inputs: a place, several places, or place -> arc weight.
        :param outputs: in the same way, the places that it puts tokens into.
        :param weight: its share in a choice; 0: a policy decides. It may depend on the marking, as
            ``"2 * #waiting"`` does.
        :param priority: of enabled ones, those with the largest number fire.
        :param inhibitors: in the same way, the places whose tokens disable it.
        :raises InputError: the name is taken, a place is not there, or a number is invalid.

        >>> import gspn
        >>> gspn.Net().place("a", tokens=2).place("b").immediate("pair", {"a": 2}, "b")
        <Net without a name: 2 places, 1 transitions, 2 arcs>
        """
        return self._with(
            lambda net: net.immediate(name, weight, priority, inputs, outputs, inhibitors)
        )

    def exponential(
        self,
        name: str,
        inputs: ArcEnds = (),
        outputs: ArcEnds = (),
        *,
        rate: Union[float, str] = 1.0,
        servers: Optional[int] = 1,
        inhibitors: ArcEnds = (),
    ) -> Net:
        """Return the net with another exponential transition and its arcs.

        :param name: its name.
        :param inputs: a place, several places, or place -> arc weight.
        :param outputs: in the same way, the places that it puts tokens into.
        :param rate: its rate (1/s). It may depend on the marking, as ``"2 * #waiting"`` does.
        :param servers: how many times it goes on at once; None: any number.
        :param inhibitors: in the same way, the places whose tokens disable it.
        :raises InputError: the name is taken, a place is not there, or a number is invalid.

        >>> import gspn
        >>> queue = gspn.Net("queue").place("jobs", capacity=3).exponential("come", (), "jobs")
        >>> queue.exponential("go", "jobs", rate=2.0).states().number
        4
        """
        return self._with(
            lambda net: net.exponential(name, rate, servers, inputs, outputs, inhibitors)
        )

    def _with(self, step: Callable[[NetBuilder], NetBuilder]) -> Net:
        return Net._of(step(NetBuilder.of(self._subject)).build(), self.notes)

    def plan(self, **keys: Any) -> Plan:
        """Return a plan with this net.

        :param keys: the keys of a plan file (``docs/plan_file.md``) but ``net``: ``robots``,
            ``resource_places``, ``policy``, ``actions`` and others. Functions are looked up in the
            current folder.
        :raises InputError: a key or a value does not fit.

        >>> import gspn
        >>> net = (gspn.Net("shuttle").place("Here", tokens=1).place("There")
        ...        .exponential("go", "Here", "There").exponential("come", "There", "Here"))
        >>> net.plan(robots={"ann": "Here"}, actions={"Here": None, "There": None})
        <Plan shuttle: 1 robots, 2 places, 2 transitions>
        """
        from gspn_framework_package.formats.net_json import net_to_json

        named = {"plan": self.name} if self.name else {}
        return _plan_of({**named, "actions": {}, **keys, "net": net_to_json(self._subject)})

    def save(self, path: str, format: Optional[str] = None) -> List[str]:
        """Write the net to a file.

        :param path: the file, whose name says in which format.
        :param format: the format, where the name does not say it: ``pnml``, ``pipe`` and others.
        :returns: what the format cannot express, in sentences.
        :raises InputError: the format is not known or cannot express the net, or the file cannot be
            written.

        >>> import gspn
        >>> gspn.example("measure").net.save("measure.pnml")
        []
        """
        from gspn_framework_package.cli.convert import bounds_for
        from gspn_framework_package.formats import format_named, format_of_name, write_net

        target = format_named(format) if format is not None else format_of_name(path)
        return write_net(self._subject, path, target.name, bounds_for(self._subject, target))

    def __repr__(self) -> str:
        return repr(self._subject)


class Plan(_Subject):
    """A plan: a net with robots, actions and a policy. :func:`load`, :func:`example`, :func:`new`
    and :meth:`Net.plan` return one."""

    _subject: ModelPlan

    def __init__(self, model: ModelPlan, file: Optional[str] = None) -> None:
        super().__init__(model, model.notes)
        self._file = file

    @property
    def net(self) -> Net:
        """Its net alone, whose weights decide instead of the policy.

        >>> import gspn
        >>> gspn.example("measure").net
        <Net measure: 5 places, 6 transitions, 14 arcs>
        """
        return Net._of(self._net)

    @property
    def robots(self) -> Dict[str, str]:
        """The robots: name -> the place where it starts.

        >>> import gspn
        >>> gspn.example("measure").robots
        {'robot_1': 'P1', 'robot_2': 'P5'}
        """
        return {robot.name: robot.place for robot in self._subject.robots}

    def for_robots(self, number: int) -> Plan:
        """Return the plan for a team of another size.

        :param number: the number of robots.
        :raises InputError: the plan does not say where that many robots start.

        >>> import gspn
        >>> gspn.example("measure").for_robots(3)
        <Plan measure: 3 robots, 5 places, 6 transitions>
        """
        return Plan(self._subject.for_robots(number), self._file)

    def check(self, *, standalone: bool = False) -> results.CheckResult:
        """Check whether the plan may run: its structure, policy and functions.

        :param standalone: whether it is to run with agents, without ROS, as :meth:`run` does.

        >>> import gspn
        >>> gspn.example("measure").check().verdict
        'may run'
        """
        from gspn_framework_package.ros.check_all import check_all

        with _progress() as progress:
            return results.CheckResult(
                check_all(self._subject, standalone=standalone, progress=progress)
            )

    def optimise(
        self,
        reward: Optional[Mapping[str, float]] = None,
        *,
        mean_time_to: Optional[str] = None,
        cost_to: Optional[str] = None,
        reach: Optional[str] = None,
        discount: Optional[float] = None,
        minimise: bool = False,
        never: Texts = (),
        at_least: Optional[Mapping[str, float]] = None,
        may_wait: Texts = (),
        simulate: float = 0.0,
        seed: int = 0,
    ) -> PolicyResult:
        """Compute the best policy for one aim.

        :param reward: place -> reward per token and second, or transition -> reward per firing: as
            much per second as possible in the long run.
        :param mean_time_to: instead, a condition to hold as soon as possible.
        :param cost_to: instead, a condition to hold at the least cost; ``reward`` has the costs.
        :param reach: instead, a condition to hold as probably as possible.
        :param discount: rate (1/s) at which later rewards count less.
        :param minimise: whether less is better.
        :param never: conditions that may never hold.
        :param at_least: transition -> least firings per second, or place -> least mean tokens.
        :param may_wait: places in which a robot may wait although it could leave.
        :param simulate: seconds of computing in which to simulate the old and the new plan.
        :param seed: seed of that simulation.
        :raises InputError: there is no aim, there are several, or a name is not in the net.
        :raises RefusedError: no policy does it.

        >>> import gspn
        >>> best = gspn.example("measure").optimise(reward={"T3": 1.0})
        >>> round(best.present, 4), best.plan
        (0.2157, <Plan measure: 2 robots, 5 places, 6 transitions>)
        """
        from gspn_framework_package.analysis.decisions.aims import AtLeast, Request
        from gspn_framework_package.analysis.decisions.optimise import optimise
        from gspn_framework_package.cli.aims import the_objective

        objective = the_objective(
            dict(reward or {}),
            mean_time_to=mean_time_to,
            cost_to=cost_to,
            reach=reach,
            discount=discount,
            minimise=minimise,
        )
        request = Request(
            objective,
            never=tuple(_texts(never)),
            at_least=tuple(AtLeast(name, bound) for name, bound in (at_least or {}).items()),
            may_wait=frozenset(_texts(may_wait)),
        )
        with _progress() as progress:
            report = optimise(
                self._subject, request, simulated=simulate, seed=seed, progress=progress
            )
        return PolicyResult(report, Plan(report.plan, self._file))

    def fit(self, logs: Texts, *, durations: str = "auto", seed: int = 0) -> FitResult:
        """Learn durations, outcomes and failures from the logs of runs.

        :param logs: event logs or rosbags, or folders of them.
        :param durations: the family of distributions; ``auto``: the one that fits best.
        :param seed: seed of the tests of fit.
        :raises InputError: a log cannot be read, or is of another net.

        >>> import gspn
        >>> plan = gspn.example("rendezvous")
        >>> ran = plan.run(firings=4, log="runs.jsonl")
        >>> plan.fit("runs.jsonl").runs
        1
        """
        from gspn_framework_package.cli.fit import learn_from_logs

        with _progress() as progress:
            learned = learn_from_logs(self._subject, list(_texts(logs)), durations, seed, progress)
        plan = learned.report.apply(self._subject, learned.logs)
        return FitResult(learned, Plan(plan, self._file))

    def compare(
        self, logs: Texts, *, replications: Optional[int] = None, seed: int = 0
    ) -> results.ComparisonResult:
        """Compare runs with the prediction of the plan.

        :param logs: event logs of runs of the plan, or folders of them.
        :param replications: number of simulated runs; None: as many as are needed.
        :param seed: seed of the simulated runs.
        :raises InputError: a log cannot be read, contains no run, or is of another net.

        >>> import gspn
        >>> plan = gspn.example("rendezvous")
        >>> ran = plan.run(firings=4, log="run.jsonl")
        >>> found = plan.compare("run.jsonl", replications=50)
        >>> len(found.measures) > 0
        True
        """
        from gspn_framework_package.cli.compare import compare_logs

        with _progress() as progress:
            found = compare_logs(
                self._subject,
                list(_texts(logs)),
                replications=replications,
                seed=seed,
                progress=progress,
            )
        return results.ComparisonResult(found)

    def run(
        self,
        seconds: Optional[float] = None,
        *,
        firings: Optional[int] = None,
        seed: Optional[int] = None,
        log: Optional[str] = None,
        allow_commands: bool = False,
    ) -> results.RunResult:
        """Run the plan on threads of this process, without ROS, until it ends or is interrupted.

        :param seconds: the longest time (s).
        :param firings: the most firings.
        :param seed: seed of the policy's draws; None: that of the plan.
        :param log: a new file for the event log, which ``fit`` and ``compare`` read.
        :param allow_commands: whether actions may run programs on this computer.
        :raises RefusedError: the check refuses the plan.
        :raises InputError: an action needs ROS, or the log exists.

        >>> import gspn
        >>> ran = gspn.example("rendezvous").run(firings=4)
        >>> len(ran.firings) >= 4, ran.fault
        (True, False)
        """
        from gspn.running import run_plan

        plan = self._subject if seed is None else self._subject.with_seed(seed)
        return run_plan(plan, seconds, firings, log, allow_commands)

    def to_dict(self) -> Dict[str, Any]:
        """Return the plan as the object of a plan file, with net and policy inside.

        >>> import gspn
        >>> sorted(gspn.example("rendezvous").to_dict())
        ['actions', 'net', 'plan', 'resource_places', 'robots', 'spawn']
        """
        from gspn_framework_package.formats.plan_json import plan_to_short_json

        return plan_to_short_json(self._subject)

    def save(self, path: str, *, overwrite: bool = False) -> List[str]:
        """Write the plan: as one ``.json`` file, or into a folder with the functions that it needs.

        :param path: the file or folder.
        :param overwrite: whether a file that exists is replaced.
        :returns: what is left to do, in sentences.
        :raises InputError: the file exists, or cannot be written.

        >>> import gspn
        >>> gspn.example("rendezvous").save("mine")
        []
        >>> gspn.load("mine").name
        'rendezvous'
        """
        from gspn_framework_package.cli.plan_output import plan_path, refuse_existing, write_plan

        target = plan_path(path)
        if not overwrite:
            refuse_existing(target, "give the name of a new file, or overwrite=True")
        folder = os.path.dirname(os.path.abspath(target))
        if self._file is None:
            data = self.to_dict()
        else:
            data = plan_file.plan_document(self._file, self._subject, folder)
        return write_plan(self._subject, data, path)

    def __repr__(self) -> str:
        said = len(self.robots), len(self.places), len(self.transitions)
        return "<Plan %s: %d robots, %d places, %d transitions>" % (self.name, *said)


class PolicyResult(Result):
    """A computed policy.

    :ivar plan: the plan with that policy.
    :ivar value: its value in the unit of the aim; None: there is none.
    :ivar lower: a certified lower bound on the value of the best policy.
    :ivar upper: a certified upper bound on it.
    :ivar present: the value of the policy before; None: not known.
    :ivar gain: how much better the new one is, relative to the old; None: not known.
    :ivar notes: what was assumed, and what was not decided.
    """

    def __init__(self, report: Report, plan: Plan) -> None:
        self._report = report
        own = report.teams[0]
        self.plan = plan
        self.value: Optional[float] = own.value
        self.lower: Optional[float] = own.lower
        self.upper: Optional[float] = own.upper
        self.present: Optional[float] = report.present
        self.gain: Optional[float] = report.gain
        self.notes: Tuple[str, ...] = (*report.undecided, *report.assumptions)

    def _json(self) -> Dict[str, Any]:
        return self._report.to_json()

    def _heading(self) -> Sequence[str]:
        return self._report.lines()

    def _records(self) -> Records:
        return self._json()["choices"]

    def _shown(self) -> Records:
        return ()


class FitResult(Result):
    """What was learned from the logs of runs.

    :ivar plan: the plan with the learned durations, outcomes, failures and rates.
    :ivar runs: number of runs.
    :ivar attempts: number of attempts of actions in them.
    :ivar notes: remarks.
    """

    def __init__(self, learned: Learned, plan: Plan) -> None:
        self._learned = learned
        self.plan = plan
        self.runs: int = learned.runs
        self.attempts: int = learned.attempts
        self.notes: Tuple[str, ...] = learned.report.notes

    def _json(self) -> Dict[str, Any]:
        return self._learned.report.to_json()

    def _heading(self) -> Sequence[str]:
        from gspn_framework_package.cli.fit import fit_table

        said = "runs: %d, attempts: %d" % (self.runs, self.attempts)
        notes = ["note: %s" % note for note in self.notes]
        return [said, *fit_table(self._learned.report), *notes]

    def _records(self) -> Records:
        return [
            {
                "place": place,
                "n": found.n,
                "cut": found.censored,
                "mean": None if found.fit is None else found.fit.duration.mean,
                "distribution": None if found.fit is None else found.fit.duration.describe(),
            }
            for place, found in self._learned.report.places.items()
        ]

    def _shown(self) -> Records:
        return ()


def load(source: Union[str, os.PathLike[str], Mapping[str, Any]]) -> Union[Net, Plan]:
    """Read a net or a plan.

    :param source: a plan's folder or file, or a net in any format that ``docs/formats.md`` lists;
        or the text of such a file, or the object of a plan file.
    :raises InputError: it cannot be read; the message says where and why.

    >>> import gspn
    >>> gspn.load(gspn.example("measure").to_dict())
    <Plan measure: 2 robots, 5 places, 6 transitions>
    """
    if isinstance(source, Mapping):
        return _plan_of(source)
    text = os.fspath(source)
    if "\n" in text or text.lstrip()[:1] in ("{", "<"):
        return _from_text(text)
    found = plan_file.read_net_or_plan(text)
    if found.plan is not None:
        return Plan(found.plan, text)
    return Net._of(found.net, found.notes)


def _from_text(text: str) -> Union[Net, Plan]:
    from gspn_framework_package.formats.registry import net_from_bytes

    if text.lstrip().startswith("{"):
        try:
            return _plan_of(json.loads(text))
        except json.JSONDecodeError as error:
            raise UsageError("the text is not JSON: %s" % error.msg) from None
    return Net._of(*net_from_bytes(text.encode("utf-8"), "text"))


def _plan_of(data: Mapping[str, Any]) -> Plan:
    """The plan of the object of a plan file; its functions are in the current folder."""
    path = os.path.join(os.getcwd(), plan_file.PLAN_FILE)
    try:
        model = plan_file.plan_from_object(data, path)
    except GspnError as error:
        if error.file == path:  # there is no such file
            error.file = None
        raise
    return Plan(replace(model, file=None))


def example(name: str) -> Plan:
    """Return an example plan that comes with the package.

    :param name: one of ``gspn.example_names()``.
    :raises InputError: there is no such example.

    >>> import gspn
    >>> gspn.example("measure")
    <Plan measure: 2 robots, 5 places, 6 transitions>
    """
    from gspn_framework_package.formats.example_plans import example_folder

    folder = example_folder(name)
    return Plan(plan_file.read_plan(folder), folder)


def new(
    template: str,
    folder: str,
    *,
    robots: Optional[int] = None,
    places: Optional[Sequence[str]] = None,
) -> Plan:
    """Write a plan to begin with, with actions, a test and a README, and return it.

    :param template: ``patrol``, ``inspect``, ``deliver``, ``charge`` or ``rendezvous``.
    :param folder: the folder to create.
    :param robots: size of the team; None: that of the template.
    :param places: names of the places where the robots go, for a template that takes them.
    :raises InputError: there is no such template, the folder exists, or an option does not fit.

    >>> import gspn
    >>> gspn.new("patrol", "tour", robots=2, places=["door", "gate"]).check().accepted
    True
    """
    from gspn_framework_package.making.templates import write

    write(template, folder, robots, places)
    return Plan(plan_file.read_plan(folder), folder)


def _times(times: Iterable[float]) -> List[float]:
    found = [float(time) for time in times]
    for time in found:
        if not 0 <= time < float("inf"):
            raise UsageError("%g is not a time in seconds, at least 0" % time)
    return found


def _texts(texts: Texts) -> Iterable[str]:
    return (texts,) if isinstance(texts, (str, os.PathLike)) else texts


def _check_choice(word: str, known: Sequence[str]) -> None:
    if word not in known:
        raise UsageError("there is no '%s'" % word, hint="choose from: %s" % ", ".join(known))


@contextmanager
def _progress() -> Iterator[ProgressLine]:
    """A progress line on a terminal."""
    from gspn_framework_package.cli.progress import ProgressLine

    with ProgressLine() as progress:
        yield progress
