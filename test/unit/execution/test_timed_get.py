"""Queues with a time limit."""

import queue

import pytest

from gspn_framework_package.execution.timed_get import get_within


@pytest.mark.parametrize("timeout", [-1.0, 0.0])
def test_an_empty_queue_is_left_at_once_when_there_is_no_time(timeout):
    for _ in range(100_000):  # Python 3.8 itself waits for ever once in some 20,000 calls
        with pytest.raises(queue.Empty):
            get_within(queue.SimpleQueue(), timeout)


def test_items_come_in_order_and_then_the_time_passes():
    source = queue.SimpleQueue()
    source.put(1)
    source.put(2)
    assert [get_within(source, 0.0), get_within(source, None)] == [1, 2]
    with pytest.raises(queue.Empty):
        get_within(source, 0.001)
