"""``gspn simulate RUN.jsonl@SLOT``: continues from the middle of a recorded run, in virtual
time."""

from __future__ import annotations

import argparse
import math
import re
from dataclasses import replace
from typing import NamedTuple, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import Simulation, estimates
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.execution.event_log import Record, clock_reading, read_log
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.condition import either
from gspn_framework_package.model.errors import InputError, UsageError
from gspn_framework_package.model.plan import Plan

CONTINUED_REPLICATIONS = 100
"""Default number of runs."""


class Beginning(NamedTuple):
    """The start of a continued simulation: the ``plan`` of a recorded run, and its state after a
    slot as a ``snapshot`` record; ``agents``: whether it was a standalone run; ``at``: when that
    was (seconds since 1970)."""

    plan: Plan
    snapshot: Record
    agents: bool
    at: float


def beginning_of(args: argparse.Namespace) -> Optional[Beginning]:
    """Return the state that ``RUN.jsonl@SLOT`` names; None if the argument names none.

    :raises InputError: the run has no such slot.
    :raises LogError: the file is not an event log.
    :raises UsageError: the argument excludes another one.
    """
    named = re.fullmatch(r"(.+\.jsonl)@(\d{1,15})", args.net_file)
    if named is None:
        return None
    path, wanted = named.group(1), int(named.group(2))
    for option in ("robots", "only_net", "source_format", "net", "const", "against", "precision"):
        if getattr(args, option):
            name = "from" if option == "source_format" else option.replace("_", "-")
            raise UsageError("--%s does not apply to a recorded run" % name)
    if args.batches or args.measure or args.timing != "run" or args.rates != "fitted":
        raise UsageError(
            "a recorded run keeps its timing; --batches, --timing and --rates do not apply"
        )
    log = read_log(path)
    last = None
    for step in replay(log):
        last = step.slot
        if step.slot == wanted:
            ledger = Ledger(TokenGame(log.plan, agents=bool(log.header.get("agents"))))
            ledger.state, ledger.hash = step.state, step.record["hash"]
            if step.state.adopted is not None:
                raise InputError(
                    "in slot %d the team no longer follows its first plan" % wanted,
                    file=path,
                    hint="a run can be continued only from a slot in which it follows the plan in "
                    "its header",
                )
            if step.state.ended is not None:
                raise InputError("the run ended in slot %d" % wanted, file=path)
            at = clock_reading(step.record, "wall") or 0.0
            return Beginning(log.plan, ledger.snapshot(), ledger.game.agents, at)
    raise InputError(
        "the run has no slot %d" % wanted,
        file=path,
        hint="the run has no slots" if last is None else "the last one is %d" % last,
    )


def simulate_from(beginning: Beginning, args: argparse.Namespace) -> Simulation:
    """Simulate many continuations of the run.

    :raises UsageError: a run would have no end.
    """
    plan = beginning.plan
    if args.until is not None:
        plan = replace(plan, until=either(plan.until, args.until)).validate()
    if math.isinf(args.time) and plan.until is None:
        raise UsageError("the length of a run is not given", hint="give --time, or --until")
    count = args.replications or CONTINUED_REPLICATIONS
    net, clock, seconds, firings, tokens, over = plan.net, [], [], [], [], []
    with ProgressLine() as progress:
        watch = Watch(progress, None)
        for k in range(count):
            run = begun(beginning, plan.with_seed(args.seed + k), args.losses)
            result = run.run(
                args.time,
                warmup=args.warmup,
                while_running=lambda slots: watch.step("runs", k),  # noqa: B023  # called at once
            )
            clock.append(result.time)
            seconds.append(result.seconds)
            firings.append([result.firings[t.name] for t in net.transitions])
            tokens.append([result.seconds * result.mean_tokens[p.name] for p in net.places])
            over.append(result.ended is not None and result.ended.reason.startswith("until: "))
    samples = estimates.Samples(
        np.array(clock),
        np.array(seconds),
        np.array(firings, dtype=float).reshape(count, -1),
        np.nan_to_num(np.array(tokens)).reshape(count, -1),
        np.array(over, dtype=bool),
    )
    return estimates.summary(
        net,
        samples,
        [{} for _ in net.places],
        plan.until is not None,
        plan=plan,
        events=int(samples.firings.sum()),
        time=args.time,
        warmup=args.warmup,
        replications=count,
        seed=args.seed,
        confidence=args.confidence,
        timing="run",
        notes=notes(beginning),
    )


def begun(beginning: Beginning, plan: Plan, losses: float) -> VirtualRun:
    """Start a run that continues from there."""
    run = VirtualRun(plan, agents=beginning.agents, loss_rate=losses)
    run.continue_from(beginning.snapshot, beginning.at)
    return run


def notes(beginning: Beginning) -> Tuple[str, ...]:
    """Notes for the reader of the numbers."""
    return (
        "continues after slot %d of the recorded run; time counts from there, and running "
        "actions start again" % beginning.snapshot["slot"],
    )
