"""``benchmarks.replayed``, with little data."""

from __future__ import annotations

from pathlib import Path

from benchmarks import replayed


def test_recorded_hours_are_played(tmp_path: Path) -> None:
    found = replayed.speed(str(tmp_path), logs=2, hours=0.05, on="local")
    assert 0.9 < found.robot_hours < 1.1 and found.firings > 100 and found.seconds > 0


def test_a_promised_gain_is_near_that_of_other_runs(tmp_path: Path) -> None:
    (gain,) = replayed.gains(str(tmp_path), 1, hours=0.5)
    assert gain.promised_gain > 0.5 < gain.held_out_gain
    assert gain.interval[0] > 0
