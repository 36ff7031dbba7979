"""Plays a firing sequence, such as the witness of a finding of the check, one firing at a time."""

from __future__ import annotations

from typing import Any, Dict, List, NamedTuple, Sequence, Tuple

from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.net import Marking, Net


class PlayedSequence(NamedTuple):
    """The result of a firing sequence.

    :ivar fired: the transitions that fired.
    :ivar markings: the initial marking, and the marking after each firing.
    :ivar stopped_by: the reason why the next transition cannot fire; empty if all fired.
    """

    net: Net
    fired: Tuple[str, ...]
    markings: Tuple[Marking, ...]
    stopped_by: str

    def to_json(self) -> Dict[str, Any]:
        """The same as plain JSON values; places without tokens are left out."""
        first, *later = [self.net.named(marking, zeros=False) for marking in self.markings]
        return {
            "start": first,
            "steps": [
                {"transition": name, "marking": marking} for name, marking in zip(self.fired, later)
            ],
            "stopped_by": self.stopped_by,
        }


def play_sequence(net: Net, sequence: Sequence[str]) -> PlayedSequence:
    """Fire transitions in order, from the initial marking until one cannot fire.

    :param sequence: names of transitions.
    """
    markings: List[Marking] = [net.initial_marking]
    for name in sequence:
        try:
            number = net.transition_number(name)
            reasons = net.why_disabled(markings[-1], number)
            if not reasons:
                markings.append(net.fire(markings[-1], number))
        except GspnError as error:
            reasons = [str(error)]
        if reasons:
            why = "%s cannot fire: %s" % (name, "; ".join(reasons))
            break
    else:
        why = ""
    return PlayedSequence(net, tuple(sequence[: len(markings) - 1]), tuple(markings), why)
