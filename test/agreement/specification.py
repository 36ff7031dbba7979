"""Has TLC check ``spec/agreement.tla``, and faults that are put into it on purpose.

Each configuration is one file of ``spec/``: ``small_*.cfg`` are checked by the tests, ``large_*.cfg`` by
``scripts/check_spec --all``. A comment in it names the number of its distinct states, so that a
change that makes TLC see less, or more, is noticed.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import List, NamedTuple, Optional, Sequence

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "spec"
MODULE = FOLDER / "agreement.tla"
JAR = ROOT / "build" / "tla" / "tla2tools.jar"


class Result(NamedTuple):
    """What TLC says. ``broken``: the invariant that does not hold, "" for none. ``error``: why TLC
    gave no answer. ``states``: distinct states; ``depth``: of the complete search; ``seconds``: by
    the clock."""

    broken: str
    error: str
    states: int
    depth: int
    seconds: float
    output: str


class Mutant(NamedTuple):
    """A fault. ``old`` stands once in the specification, and ``new`` takes its place. ``constants``
    change those of the configuration ``base``, and ``broken`` is an invariant that no longer
    holds. Without ``old``, it shows a limit that docs/agreement.md names."""

    name: str
    old: str
    new: str
    base: str
    constants: str
    broken: str


def why_not() -> str:
    """Why TLC cannot run here; "" if it can."""
    if shutil.which("java") is None:
        return "there is no Java runtime: scripts/check_spec --install"
    if not JAR.exists():
        return "TLC is not here: scripts/check_spec --install"
    return ""


def configurations(kind: str) -> List[Path]:
    """The files of a kind, "small" or "large"."""
    return sorted(FOLDER.glob(kind + "_*.cfg"))


def states_of(configuration: Path) -> int:
    """The number of distinct states that the configuration states; 0 for none."""
    found = re.search(r"^\\\* (\d+) distinct states", configuration.read_text("utf-8"), re.M)
    return int(found.group(1)) if found else 0


def check(
    configuration: Path, module: Path = MODULE, workers: int = 1, seconds: Optional[float] = None
) -> Result:
    """Have TLC check all states.

    :param workers: number of threads.
    :param seconds: when to give up (s); None for never.
    """
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        command = ["java", "-XX:+UseParallelGC" if workers > 1 else "-XX:+UseSerialGC"]
        if configuration.stem.startswith(("small", "mutant")):
            command.append("-XX:TieredStopAtLevel=1")  # half the processor time of a short run
        command += ["-cp", str(JAR), "tlc2.TLC", "-deadlock", "-workers", str(workers)]
        command += ["-metadir", scratch, "-config", str(configuration), module.name]
        try:
            done = subprocess.run(
                command,
                cwd=str(module.parent),
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                timeout=seconds,
                check=False,
            )
        except subprocess.TimeoutExpired as gone:
            text = (gone.stdout or b"").decode("utf-8", "replace")
            return Result("", "not finished after %g s" % (seconds or 0), 0, 0, 0.0, text)
    text = done.stdout.decode("utf-8", "replace")
    broken = re.search(r"Invariant (\w+) is violated", text)
    complete = "No error has been found" in text
    states = re.findall(r"([\d,]+) distinct states found", text)
    depth = re.search(r"complete state graph search is (\d+)", text)
    return Result(
        broken.group(1) if broken else "",
        "" if broken or complete else "TLC ends without an answer",
        int(states[-1].replace(",", "")) if states else 0,
        int(depth.group(1)) if depth else 0,
        time.monotonic() - begin,
        text,
    )


def check_mutant(mutant: Mutant, workers: int = 1, seconds: Optional[float] = None) -> Result:
    """Have TLC check the specification with a fault."""
    text = MODULE.read_text("utf-8")
    if mutant.old:
        if text.count(mutant.old) != 1:
            raise ValueError("%s: not once in %s: %s" % (mutant.name, MODULE.name, mutant.old))
        text = text.replace(mutant.old, mutant.new)
    cfg = (FOLDER / (mutant.base + ".cfg")).read_text("utf-8")
    for change in mutant.constants.split():
        name, value = change.split("=")
        cfg, count = re.subn(r"^  %s = .*$" % name, "  %s = %s" % (name, value), cfg, flags=re.M)
        if count != 1:
            raise ValueError("%s: no constant %s" % (mutant.name, name))
    with tempfile.TemporaryDirectory() as folder:
        module = Path(folder) / MODULE.name
        module.write_text(text, "utf-8")
        configuration = Path(folder) / "mutant.cfg"
        configuration.write_text(cfg, "utf-8")
        return check(configuration, module, workers, seconds)


def story(output: str) -> List[str]:
    """The actions of the behaviour that TLC found, in order."""
    lines = MODULE.read_text("utf-8").splitlines()
    names = []
    for name, line in re.findall(r"^State \d+: <(\w+) line (\d+)", output, re.M):
        # TLC names an action below a quantifier by its line alone
        within = re.search(r": (\w+)\(", lines[int(line) - 1]) if name == "Next" else None
        names.append(within.group(1) if within else name)
    return names


MUTANTS: Sequence[Mutant] = (
    Mutant(
        "half of an odd team is a quorum",
        "ELSE 2 * count > Cardinality(members)",
        "ELSE 2 * count + 1 >= Cardinality(members)",
        "small_three",
        "",
        "Agreement",
    ),
    Mutant(
        "either half of an even team decides",
        "THEN count > 0 /\\ SetMin(members) \\in voters",
        "THEN count > 0",
        "small_two_restart",
        "",
        "Agreement",
    ),
    Mutant(
        "a vote is not remembered over a restart",
        "LET s == without_memory(state[p])",
        "LET s == [without_memory(state[p]) EXCEPT !.accepted = Nothing]",
        "small_two_restart",
        "",
        "Agreement",
    ),
    Mutant(
        "a promise is not remembered over a restart",
        "LET s == without_memory(state[p])",
        "LET s == [without_memory(state[p]) EXCEPT !.promised = Ballot0]",
        "small_two_restart",
        "",
        "PromisesAreKept",
    ),
    Mutant(
        "an old ballot is accepted",
        "/\\ votes_in(p, t, m.by) /\\ ~less(m.ballot, t.promised)",
        "/\\ votes_in(p, t, m.by)",
        "small_three",
        "",
        "Agreement",
    ),
    Mutant(
        "a value is decided by one vote",
        "/\\ may_choose(s, {name(p), ballot[2]} \\union {m.from : m \\in votes}, s.accepted[2], all)",
        "",
        "small_two_restart",
        "",
        "Agreement",
    ),
    Mutant(
        "a new proposer ignores what was accepted",
        "ELSE IF held # {} THEN second_phase(p, after, accepted, {})",
        "",
        "small_two_restart",
        "",
        "Agreement",
    ),
    Mutant(
        "an accept of the next slot confirms any ballot",
        "held # Nothing /\\ held[1] = m.ballot /\\ m.slot",
        "held # Nothing /\\ m.slot",
        "small_three",
        "MaxLength=2",
        "Agreement",
    ),
    Mutant(
        "a restarted robot keeps its incarnation",
        "/\\ Step(p, new_life(p, [t EXCEPT !.begin_records = @ + 1]), {}, TRUE)",
        "/\\ Step(p, [t EXCEPT !.begin_records = @ + 1], {}, TRUE)",
        "small_two_restart",
        "",
        "OneLifeActs",
    ),
    Mutant(
        "a robot that lost its log takes part at once",
        "/\\ \\A r \\in witnesses_of_start(p, s) : s.welcomes[r] \\in 0..length(s.ledger)",
        "",
        "small_two_loss",
        "",
        "OneLifeActs",
    ),
    Mutant(
        "a robot continues voting after another log was let in",
        "is_our_name(p, s) == s.ledger.logs[name(p)] \\in {NONE, s.log_id}",
        "is_our_name(p, s) == TRUE",
        "small_two_spare",
        "",
        "OneMemoryVotes",
    ),
    Mutant(
        "an assertion decides without evicting",
        "ELSE asserted_off(s) \\",
        "ELSE {} \\",
        "small_two_assertion",
        "",
        "Agreement",
    ),
    Mutant(
        "a torn log counts as whole",
        "[s EXCEPT !.torn = <<s.log_id>> \\o @, !.active = FALSE, !.amnesic = TRUE,",
        "[s EXCEPT",
        "small_two_outage",
        "",
        "MembersAgree",
    ),
    Mutant(
        "a robot moves although the slot is frozen",
        "is_settled(p, s) /\\ ~s.frozen_by /\\ ~s.ledger.paused",
        "is_settled(p, s) /\\ ~s.ledger.paused",
        "small_two_partial",
        "",
        "NoMovePassesAPause",
    ),
    Mutant(
        "a proposer asks a quorum only",
        "unasked == members(s) \\ answered",
        "unasked == {}",
        "small_two_partial",
        "",
        "NoMovePassesAPause",
    ),
    Mutant(
        "a process without the memory answers for its robot",
        "mine(m) == m.log = known_log(s, m.from) /\\ m.torn = <<>>",
        "mine(m) == TRUE",
        "large_two_partial_spare",
        "",
        "NoMovePassesAPause",
    ),
    # found in the code by the search, and mended: docs/faults.md
    Mutant(
        "robots may move while a task is taken from one",
        'i.entry \\in {"Pause", "GiveBack"}',
        'i.entry = "Pause"',
        "small_two_partial_give_back",
        "",
        "NoMoveIsTakenBack",
    ),
    # docs/agreement.md, "Why it is safe", the end of 4
    Mutant(
        "a limit: one lost log and a second process, in a team of two",
        "",
        "",
        "small_two_spare",
        "Losses=1",
        "OneLifeActs",
    ),
)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Check; returns the exit code."""
    parser = argparse.ArgumentParser(prog="check_spec", description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these configurations")
    parser.add_argument("--all", action="store_true", help="the large ones, too")
    parser.add_argument("--mutants", action="store_true", help="faults instead")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="threads of TLC")
    args = parser.parse_args(arguments)
    if why_not():
        print("check_spec: " + why_not(), file=sys.stderr)
        return 2
    wrong = 0
    if args.mutants:
        for mutant in MUTANTS:
            found = check_mutant(mutant, args.workers)
            wrong += found.broken != mutant.broken
            verdict = found.broken or "NOT REFUTED"
            steps = ", ".join(story(found.output))
            print("%-40s %s after %.1f s: %s" % (mutant.name, verdict, found.seconds, steps))
        return int(wrong > 0)
    known = configurations("small") + configurations("large")
    unknown = set(args.names) - {path.stem for path in known}
    if unknown:
        parser.error("there is no %s (%s)" % (unknown.pop(), ", ".join(p.stem for p in known)))
    for path in known:
        if path.stem in args.names or (not args.names and (args.all or "small" in path.stem)):
            found = check(path, workers=args.workers)
            stated = states_of(path)
            good = not found.broken and not found.error and stated in (0, found.states)
            wrong += not good
            verdict = "holds" if good else found.broken or found.error or "not %d states" % stated
            figures = (path.stem, verdict, found.states, found.depth, found.seconds)
            print("%-32s %s: %d distinct states, depth %d, %.1f s" % figures, flush=True)
            if not good:
                print(found.output[-20000:])
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
