"""Export of a computed Markov chain, state by state, to model checkers: PRISM's explicit files, and
the DRN format of Storm. A plan under its policy, or a net whose vanishing markings were eliminated,
reaches them in this form."""

from __future__ import annotations

from typing import Dict, List, Mapping, NamedTuple, Sequence, Tuple

from gspn_framework_package.formats.symbolic import identifiers
from gspn_framework_package.model.errors import NetError


class ExplicitChain(NamedTuple):
    """A continuous-time Markov chain with explicit states.

    :ivar places: names of the places, in the order of the states' counts.
    :ivar states: the markings, by number.
    :ivar rates: triples (from state, to state, rate in 1/s), at most one per pair of states.
    :ivar initial: number of the initial state.
    :ivar labels: label -> numbers of the states that have it; ``init`` and ``deadlock`` are added
      automatically.
    """

    places: Sequence[str]
    states: Sequence[Sequence[int]]
    rates: Sequence[Tuple[int, int, float]]
    initial: int
    labels: Mapping[str, Sequence[int]] = {}

    def all_labels(self) -> Dict[str, Sequence[int]]:
        """Return the labels, including ``init`` and ``deadlock``.

        :raises NetError: a label has a name that model checkers do not accept.
        """
        busy = {source for source, _, _ in self.rates}
        dead = [number for number in range(len(self.states)) if number not in busy]
        for label in self.labels:
            if label in ("init", "deadlock") or identifiers([label])[0][label] != label:
                raise NetError(
                    "a label cannot be called '%s'" % label,
                    hint="a label consists of letters, digits and _",
                )
        return {"init": [self.initial], "deadlock": dead, **self.labels}


def prism_files(chain: ExplicitChain) -> Dict[str, bytes]:
    """Return the chain as PRISM's explicit files: ``prism -importmodel chain.all -ctmc`` reads
    them.

    :returns: extension (``sta``, ``tra``, ``lab``) -> content.
    """
    states = ["(%s)" % ",".join(identifiers(chain.places)[0].values())]
    for number, marking in enumerate(chain.states):
        states.append("%d:(%s)" % (number, ",".join(str(int(n)) for n in marking)))
    moves = ["%d %d" % (len(chain.states), len(chain.rates))]
    moves += ["%d %d %r" % move for move in sorted(chain.rates)]
    labels = chain.all_labels()
    lines = [" ".join('%d="%s"' % (i, name) for i, name in enumerate(labels))]
    for number, names in enumerate(_by_state(chain, list(labels.values()))):
        if names:
            lines.append("%d: %s" % (number, " ".join(map(str, names))))
    return {"sta": _text(states), "tra": _text(moves), "lab": _text(lines)}


def drn(chain: ExplicitChain) -> bytes:
    """Return the chain as Storm's DRN file: ``storm --explicit-drn chain.drn``. States have labels
    but no variables in this format, so the marking of each is a comment. A label that no state has
    can also only be a comment, and Storm does not know it."""
    labels = chain.all_labels()
    names = list(labels)
    of_state = _by_state(chain, list(labels.values()))
    moves: List[List[Tuple[int, float]]] = [[] for _ in chain.states]
    for source, target, rate in sorted(chain.rates):
        moves[source].append((target, rate))
    lines = [
        "@type: CTMC",
        "@parameters",
        "",
        "@reward_models",
        "",
        "@nr_states",
        str(len(chain.states)),
    ]
    lines += ["@nr_choices", str(len(chain.states)), "@model"]
    lines += ["// no state has the label %s" % name for name in names if not labels[name]]
    for number, (marking, targets) in enumerate(zip(chain.states, moves)):
        counts = ["%s=%d" % (" ".join(p.split()), n) for p, n in zip(chain.places, marking) if n]
        targets = targets or [(number, 1.0)]  # a deadlock loops on itself
        shown = "".join(" " + names[label] for label in of_state[number])
        lines.append("// %s" % ", ".join(counts))
        lines.append("state %d !%r%s" % (number, sum(rate for _, rate in targets), shown))
        lines.append("\taction 0")
        lines += ["\t\t%d : %r" % target for target in targets]
    return _text(lines)


def _by_state(chain: ExplicitChain, labels: Sequence[Sequence[int]]) -> List[List[int]]:
    found: List[List[int]] = [[] for _ in chain.states]
    for label, numbers in enumerate(labels):
        for number in numbers:
            found[number].append(label)
    return found


def _text(lines: Sequence[str]) -> bytes:
    return ("\n".join(lines) + "\n").encode("utf-8")
