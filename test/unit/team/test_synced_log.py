"""A robot's log that is brought to the disk beside the work, marked as whole at the end, and read
again after a loss of power."""

import itertools
import json
import os
import threading

import pytest

from agreement.plans import make_plan
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.log_damage import BOOT_ID
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.team import log_file

PLAN = make_plan(2, 2, False, 0.0, 0.0, False)


@pytest.fixture
def log(tmp_path, monkeypatch):
    """Opens the log of a robot, in a boot of its machine."""
    monkeypatch.setattr(log_file, "SYNC_PERIOD", 0.01)
    path = str(tmp_path / "run" / "r1.jsonl")

    def opened(boot):
        monkeypatch.setenv(BOOT_ID, boot)
        return log_file.open_log(path, PLAN, "run", "r1")

    opened.path = path
    return opened


def closed(held, whole=True):
    (held.writer.close_whole if whole else held.writer.close)()
    held.lock.close()


def lines(path):
    with open(path, "rb") as file:
        return file.readlines()


def synced(path):
    return [r for r in map(json.loads, lines(path)) if r["kind"] == "synced"]


def write(held, *numbers):
    held.writer.append(*({"kind": "peer", "robot": "r%d" % n, "log": "x"} for n in numbers))


def test_the_log_says_up_to_where_it_is_on_the_disk(log):
    held = log("one")
    write(held, 1)
    held.writer.append({"kind": "slot", "slot": 4})
    size = os.path.getsize(log.path)
    deadline = threading.Event()
    for _ in range(500):
        if synced(log.path) and synced(log.path)[-1]["bytes"] >= size:
            break
        deadline.wait(0.01)
    assert synced(log.path)[-1]["length"] == held.writer.synced_length == 5
    for _ in range(10):  # nothing new: nothing more is written
        deadline.wait(0.01)
    assert len(synced(log.path)) <= 3
    closed(held)


def test_nobody_waits_for_the_disk(log, monkeypatch):
    held = log("one")
    busy, go_on = threading.Event(), threading.Event()

    def slow(handle):
        busy.set()
        go_on.wait(10)

    monkeypatch.setattr(os, "fdatasync", slow)
    write(held, 1)
    assert busy.wait(10)  # the other thread syncs
    write(held, 2)
    assert b'"r2"' in lines(log.path)[-1]
    go_on.set()
    closed(held)


@pytest.mark.parametrize("whole", [True, False])
def test_a_log_that_was_closed_in_order_is_whole_after_the_machine_was_restarted(log, whole):
    held = log("one")
    held.writer.append({"kind": "life", "incarnation": 0}, {"kind": "slot", "slot": 7})
    closed(held, whole)
    again = log("two")
    assert again.whole == whole
    assert again.writer.synced_length == 8
    closed(again)


def test_a_log_that_went_on_after_its_mark_is_not_whole(log):
    closed(log("one"))
    held = log("one")
    held.writer.append({"kind": "life", "incarnation": 1})
    closed(held, whole=False)
    again = log("two")
    assert not again.whole
    closed(again)


@pytest.mark.parametrize("replaced", [True, False])
def test_a_log_that_is_removed_or_replaced_while_it_is_open_is_no_longer_written(log, replaced):
    held = log("one")
    write(held, 1)
    aside = log.path + ".aside"
    os.rename(log.path, aside)
    if replaced:
        with open(log.path, "wb") as file:
            file.writelines(lines(aside))
    deadline = threading.Event()

    def fails():
        try:
            held.writer.check()
        except LogError as error:
            assert error.file == log.path
            return True
        return False

    assert any(fails() or deadline.wait(0.01) for _ in range(500))
    before = lines(aside)
    with pytest.raises(LogError, match="removed or replaced"):
        write(held, 2)
    closed(held)
    assert lines(aside) == before  # not even marked as whole


@pytest.mark.parametrize("end", [b"\0" * 300, b'{"kind":"peer"}\n{"half', b"\0\n\0\n"])
def test_what_a_loss_of_power_left_behind_the_synced_part_is_cut_off(log, end):
    held = log("one")
    write(held, 1, 2)
    held.writer.sync()
    closed(held, whole=False)
    kept = lines(log.path)
    with open(log.path, "ab") as file:
        file.write(end)
    again = log("two")
    assert [r["kind"] for r in again.records] == [json.loads(line)["kind"] for line in kept[1:]]
    assert lines(log.path)[: len(kept)] == kept
    closed(again)


@pytest.mark.parametrize("boot, line", [("one", 5), *itertools.product(["one", "two"], [1, 2, 3])])
@pytest.mark.parametrize("at", [20, -1])
def test_a_damaged_log_is_kept_and_what_is_whole_goes_on(log, boot, line, at):
    held = log("one")
    held.writer.append({"kind": "life", "incarnation": 0})
    write(held, 1, 2)
    closed(held)
    kept = lines(log.path)
    flipped = bytearray(kept[line - 1])
    flipped[at] ^= 4
    damaged = b"".join([*kept[: line - 1], flipped, *kept[line:]])
    for number in range(2):
        with open(log.path, "wb") as file:
            file.write(damaged)
        again = log(boot)
        copy = log.path + ".damaged" + ("-2" if number else "")
        assert again.damage == "line %d of %s is damaged; the whole file is kept as %s" % (
            line,
            log.path,
            copy,
        )
        with open(copy, "rb") as file:
            assert file.read() == damaged
        assert len(again.records) == max(0, line - 2)
        assert lines(log.path)[: line - 1] == kept[: line - 1]
        closed(again)
        assert read_log(log.path).records[-1]["kind"] == "closed"


def test_what_is_no_log_is_left_alone(log, tmp_path):
    os.makedirs(os.path.dirname(log.path))
    with open(log.path, "w", encoding="utf-8") as file:
        file.write("my notes\n")
    with pytest.raises(LogError, match="is not an event log"):
        log("one")
    assert lines(log.path) == [b"my notes\n"]
