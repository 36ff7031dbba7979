"""Ballots and quorums: dynamic-linear voting (Jajodia and Mutchler, ACM TODS 15(2), 1990)."""

from __future__ import annotations

from typing import Any, Collection, NamedTuple, Sequence


class Ballot(NamedTuple):
    """The number of an attempt to decide a slot; the larger of two wins. It is unique: ``robot``
    increments its own counter, and ``log`` is the id of its log, because a robot that lost its log
    restarts its counter."""

    counter: int
    robot: str
    log: str = ""

    @classmethod
    def from_json(cls, data: Any) -> Ballot:
        """Parse a JSON value ``[counter, robot, log]`` (in older logs, without ``log``). :raises
        ValueError: it is malformed.
        """
        counter, robot, *log_id = data
        if type(counter) is not int or not isinstance(robot, str) or len(log_id) > 1:
            raise ValueError("not a ballot: %.80r" % (data,))
        return cls(counter, robot, *(str(x) for x in log_id))


def is_quorum(voters: Collection[str], members: Sequence[str]) -> bool:
    """Whether ``voters`` are a quorum of ``members``: more than half of them, or exactly half
    including the first. Any two quorums share a member.

    >>> is_quorum(["a"], ["a", "b"]), is_quorum(["b"], ["a", "b"]), is_quorum(["b", "c"], "abc")
    (True, False, True)
    """
    count = len([m for m in members if m in voters])
    if 2 * count == len(members):
        return count > 0 and members[0] in voters
    return 2 * count > len(members)
