"""``gspn simulate --log``: one run of a plan in virtual time, recorded as an event log."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import uuid
from dataclasses import replace
from typing import Any, Dict, Iterator, List, Optional, Union

from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.cli.continued import Beginning
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.execution.virtual_time import VirtualResult, VirtualRun
from gspn_framework_package.model.condition import either
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan


def simulate_to_log(
    subject: Union[Net, Plan],
    notes: List[str],
    args: argparse.Namespace,
    beginning: Optional[Beginning] = None,
) -> int:
    """Run the plan once, record it in ``args.log``, and print what happened.

    :param beginning: start in the middle of another run.

    :raises UsageError: the subject is a net, the run would have no end, or the file exists.
    """
    if not isinstance(subject, Plan):
        raise UsageError("--log records the run of a plan, but this is a net")
    plan = subject.with_seed(args.seed)
    if args.until is not None:
        plan = replace(plan, until=either(plan.until, args.until)).validate()
    if math.isinf(args.time) and plan.until is None:
        raise UsageError("the length of the run is not given", hint="give --time, or --until")
    for option in ("replications", "precision", "batches", "measure"):
        if getattr(args, option):
            raise UsageError("--log records a single run, so --%s does not apply" % option)
    if args.timing != "run":
        raise UsageError("--log records a plan as it runs, not as a net")
    if os.path.exists(args.log):
        raise UsageError(
            "the file exists already", file=args.log, hint="give --log the name of a new file"
        )
    agents = True if beginning is None else beginning.agents
    run = VirtualRun(plan, agents=agents, loss_rate=args.losses)
    writer = run.record_in(args.log, plan.name, uuid.uuid4().hex)
    if beginning is not None:
        run.continue_from(beginning.snapshot, beginning.at)
    try:
        with ProgressLine() as progress:
            watch = Watch(progress, None)
            result = run.run(
                args.time,
                warmup=args.warmup,
                while_running=lambda slots: watch.step("slots", slots),
            )
    finally:
        writer.close()
    if args.json:
        json.dump({**_json(result), "log": args.log, "notes": list(notes)}, sys.stdout, indent=2)
        print()
    else:
        print_notes(notes)
        print("\n".join(_text(result, args.log)))
    return int(run.state.fault)


def _json(result: VirtualResult) -> Dict[str, Any]:
    return {
        "time": result.time,
        "seconds": result.seconds,
        "slots": result.slots,
        "firings": result.firings,
        "mean_tokens": {p: None if math.isnan(n) else n for p, n in result.mean_tokens.items()},
        "ended": result.ended.reason if result.ended else None,
    }


def _text(result: VirtualResult, log: str) -> Iterator[str]:
    yield "one run of %.6g s, %d firings, recorded in %s" % (
        result.time,
        sum(result.firings.values()),
        log,
    )
    if result.ended is not None:
        yield "the run ended: %s" % result.ended.reason
    yield "%-32s %s" % ("place", "mean tokens")
    for name, mean in result.mean_tokens.items():
        yield "%-32s %.6g" % (name, mean)
    yield "%-32s %s" % ("transition", "firings")
    for name, count in result.firings.items():
        yield "%-32s %d" % (name, count)
