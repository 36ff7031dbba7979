"""What a wrong rule is that is planted on purpose, and the hunt for it."""

from __future__ import annotations

from typing import Dict, NamedTuple, Optional, Sequence, Tuple

from meaning.comparing import COMPARISONS, Case, told_by
from meaning.edited import Edit, applied
from meaning.plans import FAMILIES, made

ALL: Dict[str, Sequence[str]] = {
    "run": ("chain_and_run", "net_and_run", "check_and_run", "simulation_and_run"),
    "chain": ("chain_and_run",),
    "net": ("net_and_run", "table_and_run"),
    "check": ("check_and_run",),
    "simulation": ("simulation_and_run",),
    "optimiser": ("optimiser_and_run", "optimiser_and_net"),
    "table": ("table_and_run",),
    "virtual": ("virtual_and_run",),
    "shared": ("chain_and_run", "net_and_run", "optimiser_and_run", "optimiser_and_net"),
    "model": ("chain_and_run", "simulation_and_run"),
}
"""Statement -> the comparisons that it takes part in. ``shared`` are rules of ``analysis/plan``
that the chain, the net and the optimiser have in common; ``model`` those that all have but the
simulation."""


class Mutant(NamedTuple):
    """A wrong rule.

    :ivar rule: the rule that is broken.
    :ivar statement: where: a key of ``ALL``.
    :ivar wrong: what is wrong with it, in a few words.
    :ivar edits: how it is broken.
    :ivar families: those that are aimed at the rule; they are tried before the others.
    """

    rule: str
    statement: str
    wrong: str
    edits: Sequence[Edit]
    families: Sequence[str]

    @property
    def name(self) -> str:
        """What people call it."""
        return "%s, %s: %s" % (self.rule, self.statement, self.wrong)


class Found(NamedTuple):
    """The outcome of a hunt: the number of plans until a comparison found the mutant (None: none
    did), the plan, the comparison, and what it says."""

    plans: Optional[int]
    plan: str = ""
    comparison: str = ""
    text: str = ""


_cases: Dict[Tuple[str, int, int], Case] = {}


def _case(family: str, seed: int, number: int, fresh: bool) -> Case:
    """A plan, and what the run says about it: for mutants of other statements only once."""
    if fresh:
        return Case(made(family, seed, number))
    key = family, seed, number
    if key not in _cases:
        _cases[key] = Case(made(*key))
    return _cases[key]


def hunt(mutant: Mutant, limit: int, seed: int = 1) -> Found:
    """Compare plans until a comparison finds the mutant.

    :param limit: the most plans.
    :raises AssertionError: a comparison finds a difference without the mutant.
    """
    names = ALL[mutant.statement]
    fresh = mutant.statement in ("run", "model")
    tried = 0
    number = 0
    families = [*mutant.families, *(f for f in FAMILIES if f not in mutant.families)]
    while tried < limit:
        # ten of each aimed family, then one of each in turn
        some = mutant.families if number < 10 else families
        for family in some:
            case = _case(family, seed, number, fresh)
            tried += 1
            for name in names:
                with applied(mutant.edits):
                    try:
                        found = told_by(COMPARISONS[name], case)
                    except Exception as error:  # a mutant may crash the program: also found
                        found = ["%s: %s" % (type(error).__name__, error)]
                if found:
                    without = told_by(COMPARISONS[name], Case(made(family, seed, number)))
                    if without:
                        text = "%s differs without any mutant, by %s: %s"
                        raise AssertionError(text % (case.name, name, without[0]))
                    return Found(tried, case.name, name, found[0])
        number += 1
    return Found(None)
