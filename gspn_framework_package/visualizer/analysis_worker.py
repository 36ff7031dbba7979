"""The process that analyses for the page: a request (JSON) on stdin, lines of JSON on stdout.

Lines are ``{"progress": ...}``, ``{"part": keys of the report}`` and at last, where it failed,
``{"error": message}``. It limits itself: processor time, memory and states; whoever started it
kills it when it takes too long.
"""

from __future__ import annotations

import json
import os
import resource
import sys
from typing import Any, Dict, List, Union

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.report import Questions, report
from gspn_framework_package.formats.net_json import net_from_json
from gspn_framework_package.formats.plan_json import plan_from_json
from gspn_framework_package.model.errors import GspnError, UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

MEMORY_BYTES = 4 << 30
TIMES = 200


def main() -> int:
    """Answer the request on stdin."""
    request = json.load(sys.stdin)
    _limit_itself(float(request["seconds"]))
    try:
        _analyse(request)
    except GspnError as error:
        _say(error=str(error))
        return 1
    except MemoryError:
        _say(error="not decided: it would take more than %d GB of memory" % (MEMORY_BYTES >> 30))
        return 1
    return 0


def _limit_itself(seconds: float) -> None:
    cpu = int(2 * seconds) + 5
    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    os.nice(10)  # robots and viewers go first


def _analyse(request: Dict[str, Any]) -> None:
    def progress(what: str, count: int, seconds: float) -> None:
        _say(progress={"what": what, "count": count, "seconds": round(seconds, 2)})

    analysis = Analysis(_subject(request), limit=request["limit"], progress=progress)
    questions = _questions(request)
    if questions.structure or questions.timing:
        first = Questions(structure=questions.structure, timing=False)
        _say(part=report(analysis, first))  # what is known soon is shown soon
    _say(part=report(analysis, questions))


def _subject(request: Dict[str, Any]) -> Union[Net, Plan]:
    if request.get("policy") and "plan" in request:
        return plan_from_json(request["plan"])
    net = net_from_json(request["net"])
    return net.with_marking(tuple(request["marking"])) if "marking" in request else net


def _questions(request: Dict[str, Any]) -> Questions:
    times = _numbers(request, "at")
    if len(times) > TIMES:
        raise UsageError("more than %d times" % TIMES)
    settling = request.get("settling")
    return Questions(
        at=tuple(sorted(times)),
        reach=tuple(_texts(request, "reach")),
        cover=tuple(dict(marking) for marking in request.get("cover", ())),
        mean_time_to=tuple(_texts(request, "mean_time_to")),
        settling=float(settling) if settling is not None else None,
        structure=bool(request.get("structure")),
        timing=bool(request.get("timing")),
    )


def _numbers(request: Dict[str, Any], key: str) -> List[float]:
    values = request.get(key, [])
    if not isinstance(values, list) or not all(
        isinstance(v, (int, float)) and not isinstance(v, bool) and v >= 0 for v in values
    ):
        raise UsageError("'%s' is a list of times of at least 0" % key)
    return [float(v) for v in values]


def _texts(request: Dict[str, Any], key: str) -> List[str]:
    values = request.get(key, [])
    if not isinstance(values, list) or not all(isinstance(v, str) for v in values):
        raise UsageError("'%s' is a list of conditions" % key)
    return values


def _say(**message: Any) -> None:
    print(json.dumps(message), flush=True)


if __name__ == "__main__":
    sys.exit(main())
