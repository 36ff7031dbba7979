"""What a deliberate fault is, and the hunt for it."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import random
from pathlib import Path
from typing import Any, Callable, ContextManager, Iterator, NamedTuple, Optional, Sequence
from unittest import mock

import pytest

from agreement.schedule import Schedule, run_schedule
from agreement.transcript import FOLDER, played, read, text_of
from agreement.world import ViolationError

UNIT_TESTS = Path(__file__).parents[2] / "unit"


class Mutant(NamedTuple):
    """A deliberate fault: the ``part`` of the program that it is in, a ``text`` that describes it,
    ``apply``, which patches it in, and whether it shows in ``partial`` synchronisation or full
    (None: in both)."""

    name: str
    part: str
    text: str
    apply: Callable[[], ContextManager[Any]]
    partial: Optional[bool] = None
    robots: int = 3
    """The number of robots in most of the teams."""
    kinds: Sequence[str] = ("",)
    """The kinds of schedules in which it shows."""
    seeds: Sequence[str] = ()
    """Schedules that are run before others: random ones would find it late."""
    transcript: str = ""
    """The story, in ``test/agreement/transcripts``, that goes another way with it: no schedule
    finds it."""
    test: str = ""
    """The unit test, as ``execution/test_replica.py::test_...``, that fails with it, where no
    schedule finds it."""
    harmless: str = ""
    """Why it changes nothing that counts, in one sentence; it is not hunted."""


class Caught(NamedTuple):
    """The outcome of a hunt: the number of schedules until the mutant was caught (None: not
    caught), the schedule or transcript that caught it, and the message."""

    schedules: Optional[int]
    schedule: str
    text: str


def hunt(
    mutant: Mutant, limit: int, first_seed: int = 0, sizes: Sequence[int] = (2, 3, 5)
) -> Caught:
    """Play the mutant's transcript or call its unit test, or run schedules with it until one fails.

    :param limit: the maximum number of schedules.
    :param first_seed: the seed of the first one; each further seed is one higher.
    :param sizes: team sizes to draw from, besides the mutant's own, which counts twice.
    """
    if mutant.transcript:
        return _hunt_in_transcript(mutant)
    if mutant.test:
        return _hunt_in_test(mutant)
    with mutant.apply():
        for i in range(limit):
            if i < len(mutant.seeds):
                schedule = Schedule.parse(mutant.seeds[i])
            else:
                schedule = _random_schedule(mutant, first_seed + i, sizes)
            try:
                run_schedule(schedule)
            except ViolationError as error:
                return Caught(i + 1, str(schedule), str(error))
            except Exception as error:  # a mutant may crash the program itself: also caught
                if isinstance(error, TypeError) and "<locals>" in str(error):
                    raise  # it is the mutant that no longer fits the program
                return Caught(i + 1, str(schedule), "%s: %s" % (type(error).__name__, error))
    return Caught(None, "", "not caught in %d schedules" % limit)


def _hunt_in_transcript(mutant: Mutant) -> Caught:
    written = read(FOLDER / (mutant.transcript + ".txt"))
    with mutant.apply():
        now = played(written)
    lines = text_of(now).splitlines()
    for line, expected in zip(lines, text_of(written).splitlines()):
        if line != expected:
            text = "'%s' where the transcript has '%s'" % (line, expected)
            return Caught(1, mutant.transcript, text)
    return Caught(None, "", "the transcript %s goes as it should" % mutant.transcript)


def _hunt_in_test(mutant: Mutant) -> Caught:
    path, name = mutant.test.split("::")
    test = getattr(_unit_tests(path), name)
    try:
        with mutant.apply():
            test()
    except (Exception, pytest.fail.Exception) as error:
        return Caught(1, mutant.test, "%s: %s" % (type(error).__name__, error))
    return Caught(None, "", "%s passes" % mutant.test)


@functools.lru_cache(maxsize=None)
def _unit_tests(path: str) -> Any:
    """A module of unit tests."""
    found = importlib.util.spec_from_file_location("unit_tests_of_mutants", UNIT_TESTS / path)
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def _random_schedule(mutant: Mutant, seed: int, sizes: Sequence[int]) -> Schedule:
    source = random.Random("mutants|%d" % seed)
    robots = source.choice([*sizes, mutant.robots, mutant.robots])
    partial = source.random() < 0.5 if mutant.partial is None else mutant.partial
    return Schedule(seed, robots, partial, source.choice(list(mutant.kinds)))


@contextlib.contextmanager
def all_patched(*patches: ContextManager[Any]) -> Iterator[None]:
    """All of these patches, one inside the other."""
    with contextlib.ExitStack() as stack:
        for patch in patches:
            stack.enter_context(patch)
        yield


def wrap(owner: Any, name: str, make: Callable[[Any], Any]) -> ContextManager[Any]:
    """A patch of ``owner.name`` with what ``make`` makes of the original."""
    return mock.patch.object(owner, name, make(getattr(owner, name)))
