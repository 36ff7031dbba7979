"""Ballots, and who may decide: dynamic-linear voting (Jajodia and Mutchler, ACM TODS 15(2),
1990)."""

from __future__ import annotations

from typing import Any, Collection, NamedTuple, Sequence


class Ballot(NamedTuple):
    """The number of an attempt to decide a slot; of two the larger one wins. No two attempts have
    the same: ``robot`` increments its own counter, and ``log`` is the id of the log in which it
    does, because a robot that lost its log starts counting anew."""

    counter: int
    robot: str
    log: str = ""

    @classmethod
    def from_json(cls, data: Any) -> Ballot:
        """The ballot of a JSON value ``[counter, robot, log]`` (older logs: without the log).

        :raises ValueError: not one.
        """
        counter, robot, *log_id = data
        if type(counter) is not int or not isinstance(robot, str) or len(log_id) > 1:
            raise ValueError("not a ballot: %.80r" % (data,))
        return cls(counter, robot, *(str(x) for x in log_id))


def is_quorum(voters: Collection[str], members: Sequence[str]) -> bool:
    """Whether ``voters`` may decide for ``members``: more than half of them, or exactly half with
    the first one among these. Any two quorums share a member.

    >>> is_quorum(["a"], ["a", "b"]), is_quorum(["b"], ["a", "b"]), is_quorum(["b", "c"], "abc")
    (True, False, True)
    """
    count = sum(1 for m in members if m in voters)
    if 2 * count == len(members):
        return count > 0 and members[0] in voters
    return 2 * count > len(members)
