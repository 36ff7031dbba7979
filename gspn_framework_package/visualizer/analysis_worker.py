"""The process that runs the page's analyses: a JSON request on stdin, lines of JSON on stdout.

Lines are ``{"progress": ...}``, ``{"part": keys of the report}`` and at the end, if it failed,
``{"error": message}``. The process limits its own processor time, memory and states; its parent
kills it if it takes too long. The modules that compute policies, simulate, predict and prove are
imported on demand, since imports dominate the time of a small analysis.
"""

from __future__ import annotations

import json
import math
import os
import resource
import sys
from dataclasses import replace
from itertools import islice
from typing import Any, Dict, Iterator, List, Optional, Union

import numpy as np

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.intervals import expected, steady_intervals
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.plan.structure import may_lose_robots
from gspn_framework_package.analysis.plan.subnets import TITLES
from gspn_framework_package.analysis.report import Questions, report
from gspn_framework_package.analysis.report_measures import INFINITE
from gspn_framework_package.analysis.watch import Progress
from gspn_framework_package.formats.net_json import net_from_json
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_short_json
from gspn_framework_package.model.errors import GspnError, UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming
from gspn_framework_package.visualizer.activity import whole_field
from gspn_framework_package.visualizer.optimise_form import request_in_form, simulated_of
from gspn_framework_package.visualizer.optimised import PolicyChanges
from gspn_framework_package.visualizer.simulation_form import (
    asked_in_form,
    form_number,
    form_texts,
    sweep_in_parts,
)

ANALYSIS_MEMORY = 4 << 30
TIMES = 200

PREDICTED = 400
"""Simulated runs for the prediction of a live run."""

FOR_PROOFS = 0.8
"""The part of the time in which a question is decided, so that there is time left to report how far
it came."""

LIKELY = 40
"""How many of the most probable states are reported individually."""


def main() -> int:
    """Answer the request on stdin and return the exit status."""
    request = json.load(sys.stdin)
    _limit_itself(float(request["seconds"]))
    try:
        _analyse(request)
    except GspnError as error:
        _say(error=str(error))
        return 1
    except MemoryError:
        _say(error="not decided: it would need more than %d GB of memory" % (ANALYSIS_MEMORY >> 30))
        return 1
    return 0


def _limit_itself(seconds: float) -> None:
    cpu = int(2 * seconds) + 5
    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu))
    resource.setrlimit(resource.RLIMIT_AS, (ANALYSIS_MEMORY, ANALYSIS_MEMORY))
    os.nice(10)  # robots and viewers take precedence


def _analyse(request: Dict[str, Any]) -> None:
    def progress(what: str, count: int, seconds: float) -> None:
        _say(progress={"what": what, "count": count, "seconds": round(seconds, 2)})

    if "optimise" in request:
        _optimise(request, progress)
        return
    subject = _subject(request)
    if "simulate" in request:
        _say(part={"simulation": _simulate(subject, request["simulate"], progress)})
        return
    if "sweep" in request:
        sweep_in_parts(subject, request["sweep"], progress, lambda part: _say(part={"sweep": part}))
        return
    if "predict" in request:
        paces: Iterator[Dict[str, Any]] = iter(())
        if "exact" in request:
            paces = exact_paces(subject, form_number(request, "exact"), progress)
        for found in islice(paces, 1):  # how far off it may be takes longer
            _say(part={"exact": found})
        _say(part={"prediction": _predict(subject, request["predict"], progress)})
        for found in paces:
            _say(part={"exact": found})
        return
    if "decide" in request:
        _say(part={"decided": _decide(subject, request, progress)})
        return
    questions = _questions(request)
    analysis = Analysis(
        subject,
        limits=_limits(request),
        timing=_reading(request) if isinstance(subject, Plan) else None,
        structure=questions.structure,
        progress=progress,
    )
    if questions.structure or questions.timing:
        first = Questions(structure=questions.structure, timing=False)
        _say(part=report(analysis, first))  # the page shows the quick results first

    def say(answers: Dict[str, Any]) -> None:
        if answers.get("steady_state") is not None:
            answers["likely_states"] = _likely_states(analysis)
        _say(part=answers)

    found = report(analysis, questions, before_intervals=say)
    if "intervals" in found:
        _say(part={key: found[key] for key in ("intervals", "interval_sources", "undecided")})


def _optimise(request: Dict[str, Any], progress: Any) -> None:
    """Compute and report a policy; the new plan is a separate part, since it may be large."""
    from gspn_framework_package.analysis.decisions.optimise import optimise
    from gspn_framework_package.analysis.decisions.report import MOST_CHOICES

    plan = plan_from_json(request["plan"])
    asked = request_in_form(request["optimise"], plan, _limits(request))
    simulated = simulated_of(request["optimise"])
    found = optimise(plan, asked, simulated=simulated, progress=progress)
    changes = PolicyChanges(found.plan, found.choices[:MOST_CHOICES])
    _say(plan=plan_to_short_json(found.plan), changed=changes.changed, same=changes.same)
    answer = found.to_json()
    del answer["plan"]
    answer["asked"] = {
        "never": list(asked.never),
        "may_wait": sorted(asked.may_wait),
        "uncertain": {name: list(rates) for name, rates in asked.uncertain.items()},
        "timing": asked.reading,
        "fitted": asked.fitted,
    }
    _say(part={"optimised": _readable(answer)})


def _readable(value: Any) -> Any:
    """The value, with numbers that JSON cannot represent replaced by "infinite" or None."""
    if isinstance(value, dict):
        return {key: _readable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_readable(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else INFINITE if value > 0 else "-" + INFINITE
    return value


def _limits(request: Dict[str, Any]) -> Limits:
    return Limits(
        states=request["limit"], seconds=float(request["seconds"]), memory=ANALYSIS_MEMORY // 2
    )


def _simulate(subject: Union[Net, Plan], asked: Any, progress: Any) -> Dict[str, Any]:
    """Simulate many runs and return the estimates, with confidence intervals."""
    from gspn_framework_package.analysis.simulation import simulate

    result = simulate(subject, progress=progress, **asked_in_form(asked, "simulate")._asdict())
    return {**result.to_json(), "titles": {key: TITLES[key] for key in result.subnets}}


def _predict(subject: Union[Net, Plan], asked: Any, progress: Any) -> Dict[str, Any]:
    """Predict how often each place is visited, and how the number of firings grows with time: see
    :mod:`~gspn_framework_package.visualizer.live_comparison`."""
    from gspn_framework_package.analysis.monitoring.prediction import (
        Span,
        expected_paces,
        predict,
    )
    from gspn_framework_package.visualizer.what_if import growths

    if not isinstance(subject, Plan) or not isinstance(asked, dict):
        raise UsageError("only a run of a plan can be predicted")
    time = form_number(asked, "time")
    if not time:
        raise UsageError("how long is a run?", hint="'predict' needs a 'time'")
    plan = replace(subject, until=None)  # the growth is that of a run that does not end
    runs = whole_field(asked, "runs", PREDICTED, 2, PREDICTED)
    sample = predict([Span(plan, time)], replications=runs, progress=progress)
    return {
        "paces": expected_paces(plan, sample),
        "growth": growths(plan, sample),
        "runs": sample.size,
    }


def exact_paces(
    subject: Union[Net, Plan], seconds: Optional[float], progress: Progress
) -> Iterator[Dict[str, Any]]:
    """The firings per second of each transition in the long run, by the Markov chain with
    ``states`` states, and then again with the half widths of their intervals, which take longer,
    and ``notes`` about these; or ``why`` there is no such answer within so many seconds."""
    if isinstance(subject, Plan):
        differing = PlanTiming(subject).differing
        if differing:
            yield {"why": differing}
            return
        subject = replace(subject, until=None)
    limits = Limits(seconds=seconds or 1.0, memory=ANALYSIS_MEMORY // 2)
    try:
        analysis = Analysis(subject, limits=limits, structure=False, progress=progress)
        answer = {
            "states": analysis.space.count(slice(None)),
            "throughput": analysis.measures.throughput,
            "notes": expected(analysis).notes,
        }
    except GspnError as error:
        yield {"why": error.message}
        return
    yield answer
    found, _ = steady_intervals(analysis)
    yield {**answer, "half_widths": {name: half for name, (_, half) in found["throughput"].items()}}


def _decide(
    subject: Union[Net, Plan], request: Dict[str, Any], progress: Progress
) -> List[Dict[str, Any]]:
    """Decide a question about all markings, also with losses of robots where these are possible."""
    from gspn_framework_package.analysis.proofs.ladder import decide_for_team
    from gspn_framework_package.analysis.proofs.questions import MarkingQuestion

    asked = request["decide"]
    if not isinstance(asked, dict):
        raise UsageError("'decide' must be an object")
    kind, about = asked.get("kind", ""), asked.get("about", "")
    if not isinstance(kind, str) or not isinstance(about, str):
        raise UsageError("'kind' and 'about' must be texts")
    answers = decide_for_team(
        subject,
        MarkingQuestion(kind, about),
        losses=isinstance(subject, Plan) and may_lose_robots(subject),
        seconds=FOR_PROOFS * request["seconds"],
        limit=request["limit"],
        progress=progress,
    )
    return [{**answer.to_json(), "statement": answer.question.statement} for answer in answers]


def _likely_states(analysis: Analysis) -> List[Dict[str, Any]]:
    """The most probable tangible states: marking, steady-state probability and mean sojourn time
    in seconds."""
    measures = analysis.measures
    stays, graph = measures.sojourn_times, measures.graph
    found = []
    for i in np.argsort(-measures.distribution, kind="stable")[:LIKELY].tolist():
        marking = graph.marking(int(measures.chain.states[i]))
        stay = float(stays[i])
        found.append(
            {
                "marking": {p.name: n for p, n in zip(graph.net.places, marking) if n},
                "probability": float(measures.distribution[i]),
                "mean_stay": stay if math.isfinite(stay) else INFINITE,
            }
        )
    return found


def _reading(request: Dict[str, Any]) -> Optional[str]:
    reading = request.get("reading")
    if reading is not None and not isinstance(reading, str):
        raise UsageError("'reading' must be run or net")
    return reading


def _subject(request: Dict[str, Any]) -> Union[Net, Plan]:
    if request.get("policy") and "plan" in request:
        plan = plan_from_json(request["plan"])
        return replace(plan, net=_at(request, plan.net))
    return _at(request, net_from_json(request["net"]))


def _at(request: Dict[str, Any], net: Net) -> Net:
    """The net, with the requested marking as its initial marking."""
    return net.with_marking(tuple(request["marking"])) if "marking" in request else net


def _questions(request: Dict[str, Any]) -> Questions:
    times = _numbers(request, "at")
    if len(times) > TIMES:
        raise UsageError("more than %d times" % TIMES)
    settling = request.get("settling")
    rewards = request.get("rewards", {})
    if not isinstance(rewards, dict):
        raise UsageError("'rewards' must map places and transitions to numbers")
    for name, value in rewards.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise UsageError("the reward of '%s' is not a number" % name[:80])
    return Questions(
        at=tuple(sorted(times)),
        reach=tuple(form_texts(request, "reach", "conditions")),
        cover=tuple(dict(marking) for marking in request.get("cover", ())),
        mean_time_to=tuple(form_texts(request, "mean_time_to", "conditions")),
        rewards={name: float(value) for name, value in rewards.items()},
        settling=float(settling) if settling is not None else None,
        structure=bool(request.get("structure")),
        timing=bool(request.get("timing")),
    )


def _numbers(request: Dict[str, Any], key: str) -> List[float]:
    values = request.get(key, [])
    if not isinstance(values, list) or not all(
        isinstance(v, (int, float)) and not isinstance(v, bool) and v >= 0 for v in values
    ):
        raise UsageError("'%s' must be a list of times of at least 0" % key)
    return [float(v) for v in values]


def _say(**message: Any) -> None:
    print(json.dumps(message), flush=True)


if __name__ == "__main__":
    sys.exit(main())
