"""What the questions of a net or plan are answered with: values that show themselves as text, in a
notebook as a table or a picture, and give their numbers away."""

from __future__ import annotations

import html
import io
import math
import os
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from gspn.tables import Records, html_table, text_table
from gspn_framework_package.model.errors import UsageError

if TYPE_CHECKING:
    from gspn_framework_package.analysis.preflight.report import PreflightReport
    from gspn_framework_package.analysis.proofs.ladder import Answer
    from gspn_framework_package.analysis.queries.answers import QueryAnswer
    from gspn_framework_package.analysis.simulation import Simulation
    from gspn_framework_package.analysis.simulation.estimates import Estimate
    from gspn_framework_package.analysis.solution.measures import Measures
    from gspn_framework_package.analysis.solution.passage import Passage
    from gspn_framework_package.cli.compare import LogComparison


class Result:
    """An answer. It shows itself as text, and in a notebook as a table.

    >>> import gspn
    >>> answer = gspn.example("measure").check()
    >>> answer.to_dict()["accepted"]
    True
    """

    def to_dict(self) -> Dict[str, Any]:
        """Return the answer as plain JSON values: those of the verb's ``--json``, where it has one.

        >>> import gspn
        >>> sorted(gspn.example("measure").passage("P4 == 1").to_dict())
        ['condition', 'mean_time', 'probability', 'residual', 'within']
        """
        return self._json()

    def to_frame(self) -> Any:
        """Return the rows of the answer as a data frame of pandas.

        :raises InputError: pandas is not installed.

        >>> import gspn
        >>> frame = gspn.example("measure").steady().to_frame()  # doctest: +SKIP
        """
        try:
            import pandas
        except ModuleNotFoundError:
            raise UsageError(
                "a data frame needs pandas, which is not installed",
                hint="pip install pandas; to_dict() needs nothing",
            ) from None
        return pandas.DataFrame(list(self._records()))

    def _json(self) -> Dict[str, Any]:
        """The answer as plain JSON values."""
        raise NotImplementedError

    def _heading(self) -> Sequence[str]:
        """The lines above the table."""
        raise NotImplementedError

    def _records(self) -> Records:
        """The rows of the table."""
        raise NotImplementedError

    def _shown(self) -> Records:
        """The rows of the table that are shown."""
        return self._records()

    def __repr__(self) -> str:
        records = self._shown()
        return "\n".join([*self._heading(), *(text_table(records) if records else ())])

    def _html_parts(self) -> Tuple[Sequence[str], Records]:
        """The heading and the rows that a notebook shows."""
        return self._heading(), self._shown()

    def _repr_html_(self) -> str:
        heading, records = self._html_parts()
        above = "<pre>%s</pre>" % html.escape("\n".join(heading))
        return above + (html_table(records) if records else "")


class CheckResult(Result):
    """Whether a plan may run.

    :ivar accepted: whether it may.
    :ivar verdict: the verdict, in a few words.
    :ivar findings: what was found: ``check``, ``severity``, ``text`` and details.
    """

    def __init__(self, report: PreflightReport) -> None:
        self._report = report
        self.accepted: bool = not report.refused
        self.verdict: str = report.verdict
        self.findings: List[Dict[str, Any]] = self._json()["items"]

    def _json(self) -> Dict[str, Any]:
        return self._report.to_json()

    def _heading(self) -> Sequence[str]:
        return str(self._report).splitlines()

    def _records(self) -> Records:
        return [{key: item[key] for key in ("severity", "check", "text")} for item in self.findings]

    def _shown(self) -> Records:
        return ()

    def _html_parts(self) -> Tuple[Sequence[str], Records]:
        return [self.verdict], self._records()


class StatesResult(Result):
    """The reachable markings. An attribute is None if it was not decided; ``undecided`` says why.

    :ivar number: their number.
    :ivar bounded: whether they are finitely many.
    :ivar bounds: place -> most tokens; infinite if there is no bound.
    :ivar deadlocks: number of markings in which nothing can happen any more.
    :ivar live: whether every transition can always fire again.
    :ivar reversible: whether the initial marking can always be reached again.
    :ivar dead_transitions: the transitions that never fire.
    :ivar undecided: question -> why it was not decided.
    """

    def __init__(self, data: Dict[str, Any]) -> None:
        self._data = data
        self.number: Optional[int] = (data["states"] or {}).get("total")
        self.bounded: Optional[bool] = data["bounded"]
        self.bounds: Dict[str, Optional[float]] = {
            place: math.inf if bound == "infinite" else bound
            for place, bound in data["bounds"].items()
        }
        self.deadlocks: Optional[int] = (data["deadlocks"] or {}).get("count")
        self.live: Optional[bool] = data["live"]
        self.reversible: Optional[bool] = data["reversible"]
        self.dead_transitions: Optional[List[str]] = data["dead_transitions"]
        self.undecided: Dict[str, str] = data["undecided"]

    def _json(self) -> Dict[str, Any]:
        return self._data

    def _heading(self) -> Sequence[str]:
        from gspn_framework_package.cli.analysis_text import analysis_text

        return list(analysis_text(self._data))

    def _records(self) -> Records:
        return [{"place": place, "bound": bound} for place, bound in self.bounds.items()]

    def _shown(self) -> Records:
        return ()


class SteadyResult(Result):
    """The long run.

    :ivar mean_tokens: place -> mean number of tokens.
    :ivar throughput: transition -> firings per second.
    :ivar waiting: place -> mean time (s) that a token stays.
    :ivar token_distribution: place -> number of tokens -> probability.
    :ivar reward: the reward per second; None if none was asked for.
    """

    def __init__(self, measures: Measures, reward: Optional[float] = None) -> None:
        self.mean_tokens: Dict[str, float] = measures.mean_tokens
        self.throughput: Dict[str, float] = measures.throughput
        self.waiting: Dict[str, float] = measures.mean_waiting_time
        self.token_distribution: Dict[str, Dict[int, float]] = measures.token_distribution
        self.reward = reward

    def _json(self) -> Dict[str, Any]:
        from gspn_framework_package.analysis.report import plain

        data = {
            "mean_tokens": self.mean_tokens,
            "throughput": self.throughput,
            "mean_waiting_time": self.waiting,
            "token_distribution": {
                place: {str(n): share for n, share in shares.items()}
                for place, shares in self.token_distribution.items()
            },
        }
        if self.reward is not None:
            data["reward"] = self.reward
        return dict(plain(data))

    def _heading(self) -> Sequence[str]:
        heading = ["in the long run"]
        if self.reward is not None:
            heading.append("reward: %.6g /s" % self.reward)
        return heading

    def _records(self) -> Records:
        return _measure_records(self.mean_tokens, self.throughput)


def _measure_records(
    tokens: Mapping[str, float], throughput: Mapping[str, float]
) -> List[Dict[str, Any]]:
    return [
        *({"measure": "mean tokens", "name": n, "value": v} for n, v in tokens.items()),
        *({"measure": "throughput (1/s)", "name": n, "value": v} for n, v in throughput.items()),
    ]


class TransientResult(Result):
    """What holds at given times.

    :ivar times: the times (s), in order.
    :ivar mean_tokens: for each time: place -> mean number of tokens.
    :ivar throughput: for each time: transition -> firings per second.
    """

    def __init__(self, found: Sequence[Tuple[float, Measures]]) -> None:
        self.times: List[float] = [time for time, _ in found]
        self.mean_tokens: List[Dict[str, float]] = [m.mean_tokens for _, m in found]
        self.throughput: List[Dict[str, float]] = [m.throughput for _, m in found]

    def _json(self) -> Dict[str, Any]:
        return {
            "transient": [
                {"time": time, "mean_tokens": tokens, "throughput": throughput}
                for time, tokens, throughput in self._parts()
            ]
        }

    def _parts(self) -> List[Tuple[float, Dict[str, float], Dict[str, float]]]:
        return list(zip(self.times, self.mean_tokens, self.throughput))

    def _heading(self) -> Sequence[str]:
        return ["at %s s" % ", ".join("%g" % time for time in self.times)]

    def _records(self) -> Records:
        return [
            {"time": time, **record}
            for time, tokens, throughput in self._parts()
            for record in _measure_records(tokens, throughput)
        ]


class PassageResult(Result):
    """When a condition first holds.

    :ivar condition: the condition.
    :ivar probability: the probability that it ever holds.
    :ivar mean_time: the mean time (s) until then; infinite if it may never hold.
    :ivar within: time (s) -> the probability that it holds until then.
    """

    def __init__(self, condition: str, times: Sequence[float], found: Passage) -> None:
        self._residual = found.residual
        self.condition = condition
        self.probability: float = found.probability
        self.mean_time: float = found.mean_time
        self.within: Dict[float, float] = dict(zip(times, found.within))

    def _json(self) -> Dict[str, Any]:
        from gspn_framework_package.analysis.report import plain

        within = [{"time": time, "probability": p} for time, p in self.within.items()]
        data = {
            "condition": self.condition,
            "mean_time": self.mean_time,
            "probability": self.probability,
            "within": within,
            "residual": self._residual,
        }
        return dict(plain(data))

    def _heading(self) -> Sequence[str]:
        said = self.condition, self.mean_time, self.probability
        return ["mean time to %s: %.6g s, probability %.6g" % said]

    def _records(self) -> Records:
        return [{"time": time, "probability": p} for time, p in self.within.items()]


class ProofResult(Result):
    """The answers to questions about all markings.

    :ivar proven: whether all of them are proven.
    :ivar answers: for each: the question (``kind``, ``about``), ``verdict`` ("proven", "violated",
        "not decided"), ``decided_by``, and of a violation the firing ``sequence`` and ``marking``.
    :ivar certificates: the proof of each answer, as plain JSON values; None where there is none.
    """

    def __init__(self, answers: Sequence[Answer]) -> None:
        from gspn_framework_package.cli.check import all_proven

        self._answers = list(answers)
        self.proven: bool = all_proven(self._answers)
        self.answers: List[Dict[str, Any]] = [answer.to_json() for answer in answers]
        self.certificates: List[Optional[Dict[str, Any]]] = [a.certificate for a in answers]

    def _json(self) -> Dict[str, Any]:
        return {"answers": self.answers}

    def _heading(self) -> Sequence[str]:
        from gspn_framework_package.cli.check import answer_text

        return [answer_text(answer) for answer in self._answers]

    def _records(self) -> Records:
        return [
            {
                "question": answer.question.statement,
                "verdict": answer.verdict,
                "decided by": answer.decided_by,
                "firings": ", ".join(answer.sequence or ()),
            }
            for answer in self._answers
        ]

    def _shown(self) -> Records:
        return ()

    def _html_parts(self) -> Tuple[Sequence[str], Records]:
        return ["proven" if self.proven else "not all is proven"], self._records()


class QueryResult(Result):
    """The answer to a temporal query.

    :ivar value: the probability or the share of time that was asked for; None otherwise.
    :ivar interval: the bounds of ``value``; None if there is none.
    :ivar holds: the answer to a query with yes or no; None if it is not decided.
    :ivar undecided: why it is not decided; "" if it is.
    """

    def __init__(self, answer: QueryAnswer) -> None:
        self._answer = answer
        self.value: Optional[float] = answer.value
        self.interval: Optional[Tuple[float, float]] = answer.interval
        self.holds: Optional[bool] = answer.holds
        self.undecided: str = answer.undecided

    def _json(self) -> Dict[str, Any]:
        return self._answer.to_json()

    def _heading(self) -> Sequence[str]:
        from gspn_framework_package.cli.queries import query_text

        return [query_text(self._answer)]

    def _records(self) -> Records:
        return [self.to_dict()]

    def _shown(self) -> Records:
        return ()


class SimulationResult(Result):
    """Estimates from many simulated runs; each is a ``mean`` with the ``half_width`` of its
    interval.

    :ivar mean_tokens: place -> mean number of tokens.
    :ivar throughput: transition -> firings per second.
    :ivar end_time: when a run ended (s).
    :ivar reached: share of the runs that reached the condition; None without one.
    :ivar time_to_condition: when they did (s); None without a condition, or if none did.
    :ivar notes: remarks.
    """

    def __init__(self, found: Simulation) -> None:
        self._found = found
        self.mean_tokens: Dict[str, Estimate] = found.mean_tokens
        self.throughput: Dict[str, Estimate] = found.throughput
        self.end_time: Estimate = found.end_time
        self.reached: Optional[Estimate] = found.reached
        self.time_to_condition: Optional[Estimate] = found.time_to_condition
        self.notes: Tuple[str, ...] = tuple(found.notes)

    def _json(self) -> Dict[str, Any]:
        return self._found.to_json()

    def _heading(self) -> Sequence[str]:
        found = self._found
        said = found.replications, found.seed, format(found.events, ","), 100 * found.confidence
        told = "%d runs, seed %d, %s firings; intervals of %g %% confidence" % said
        return [told, *("note: %s" % note for note in self.notes)]

    def _records(self) -> Records:
        from gspn_framework_package.cli.simulate import simulated_rows

        names = ("measure", "name", "mean", "half width")
        return [dict(zip(names, row)) for row in simulated_rows(self._found)]


class ComparisonResult(Result):
    """Runs beside the prediction of their plan.

    :ivar departs: whether they deviate from it.
    :ivar measures: for each measure: ``name``, ``unit``, ``predicted``, ``low``, ``high``,
        ``observed``, ``inside`` and others.
    :ivar alarms: the alarms of all streams.
    """

    def __init__(self, found: LogComparison) -> None:
        self._found = found
        self.departs: bool = found.departs
        data = self._json()
        self.measures: List[Dict[str, Any]] = data["measures"]
        self.alarms: List[Dict[str, Any]] = data["alarms"]

    def _json(self) -> Dict[str, Any]:
        return self._found.to_json()

    def _heading(self) -> Sequence[str]:
        from gspn_framework_package.cli.compare import comparison_text

        return list(comparison_text(self._found))

    def _records(self) -> Records:
        return self.measures

    def _shown(self) -> Records:
        return ()


class RunResult(Result):
    """A run on threads.

    :ivar reason: why it ended.
    :ivar fault: whether an action or the run itself failed.
    :ivar seconds: how long it took.
    :ivar marking: place -> tokens at its end.
    :ivar firings: what fired, in order: ``number``, ``transition`` and ``moves`` of robots.
    """

    def __init__(
        self,
        reason: str,
        fault: bool,
        seconds: float,
        marking: Dict[str, int],
        firings: List[Dict[str, Any]],
    ) -> None:
        self.reason, self.fault, self.seconds = reason, fault, seconds
        self.marking, self.firings = marking, firings

    def _json(self) -> Dict[str, Any]:
        return vars(self)

    def _heading(self) -> Sequence[str]:
        there = ", ".join("%s: %d" % item for item in self.marking.items() if item[1])
        said = self.reason, len(self.firings), self.seconds, there
        return ["ended: %s; %d firings in %.1f s; %s" % said]

    def _records(self) -> Records:
        return self.firings


class Picture:
    """A picture, which a notebook shows.

    :param about: what it shows.
    :param render: returns it in an image format, such as ``svg``.
    :param formats: the image formats.
    """

    def __init__(self, about: str, render: Callable[[str], bytes], formats: Sequence[str]) -> None:
        self._about, self._render, self._formats = about, render, formats

    @property
    def svg(self) -> str:
        """The picture as SVG, to be put into a page.

        :raises InputError: what draws is not installed.

        >>> import gspn
        >>> gspn.example("measure").draw().svg[:4]
        '<svg'
        """
        text = self._render("svg").decode("utf-8")
        return text[text.index("<svg") :]

    def save(self, path: str) -> None:
        """Write the picture to a file.

        :param path: the file, whose name says in which format.
        :raises InputError: the format is not known, or the file cannot be written.

        >>> import gspn
        >>> gspn.example("measure").draw().save("net.svg")
        """
        from gspn_framework_package.formats.source import write_bytes

        image = os.path.splitext(path)[1].lower().lstrip(".")
        if image not in self._formats:
            raise UsageError(
                "the name '%s' does not indicate a picture format" % path,
                hint="use the ending .%s" % ", .".join(self._formats),
            )
        write_bytes(path, self._render(image))

    def __repr__(self) -> str:
        return "<Picture: %s>" % self._about

    def _repr_svg_(self) -> str:
        return self.svg


def picture_of_figure(about: str, figure: Any) -> Picture:
    """Return a figure of matplotlib as a picture."""
    from gspn_framework_package.cli.plot import save_picture

    def render(image: str) -> bytes:
        file = io.BytesIO()
        save_picture(figure, file, image)
        return file.getvalue()

    return Picture(about, render, ("svg", "png", "pdf"))
