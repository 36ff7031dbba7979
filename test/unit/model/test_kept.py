"""A bounded memory of what is costly to make."""

import pytest

from gspn_framework_package.model.kept import Kept


def test_what_was_asked_for_last_is_kept():
    made = []

    def square(n):
        made.append(n)
        return n * n

    squares = Kept(most=2)
    assert [squares.get(n, lambda n=n: square(n)) for n in (1, 2, 1, 3, 1, 2)] == [1, 4, 1, 9, 1, 4]
    assert made == [1, 2, 3, 2] and len(squares) == 2


def test_nothing_is_kept_of_what_cannot_be_made():
    kept = Kept(most=2)
    with pytest.raises(ZeroDivisionError):
        kept.get("a", lambda: 1 // 0)
    assert not len(kept) and kept.get("a", lambda: 1) == 1
