"""Inductive invariants: z3 searches for them, and the prover shows what z3 says of them.

z3 (Spacer) is asked whether a bad marking can be reached, with priorities and the policy as
inequalities. "No" comes with inequalities that hold at the start and that every firing keeps, each
with the help of the others. Each becomes a lemma of a certificate, with a proof for every
transition that does not obviously keep it. "Yes" comes with firings, which the caller has to
replay.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import Any, Dict, Iterable, List, Optional, Tuple, Union

from gspn_framework_package.analysis.proofs.checker import (
    All,
    Atom,
    Formula,
    Problem,
    Some,
    breaking,
    guard,
    may_break,
    opposite,
    read_lemma,
)
from gspn_framework_package.analysis.proofs.prover import Candidate, Prover, written_lemma
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError, how_to_install

MOST_CLAUSES = 500
"""Maximum number of lemmas that an answer of z3 becomes."""

_AS_WRITTEN = ("xform.inline_eager", "xform.inline_linear", "xform.slice")
"""The transformations of rules that z3 makes."""


def search_inductive(
    problem: Problem, watch: Watch, prover: Optional[Prover] = None
) -> Union[Dict[str, Any], List[str]]:
    """A certificate, or the names of transitions whose firings lead to where all facts hold, as z3
    says.

    :param prover: the earlier search for a proof.
    :raises LimitError: neither was found, or there is no z3.
    :raises CancelledError: the work was cancelled.
    """
    try:
        import z3  # large, and not everybody has it
    except ImportError:
        raise LimitError("z3 is not there: %s" % how_to_install("z3")) from None
    found = _Spacer(z3, problem, watch).ask()
    if isinstance(found, list):
        return [problem.net.transitions[t].name for t in found]
    return _certificate(problem, found, watch, prover or Prover(problem, watch))


def _certificate(
    problem: Problem, invariant: Formula, watch: Watch, prover: Prover
) -> Dict[str, Any]:
    """The certificate that an invariant makes.

    :raises LimitError: a part of it is not shown.
    """
    clauses = [Some(parts) for parts in _clauses(invariant)]
    whole = _shown(problem._replace(facts=(*clauses, *problem.facts)), watch, prover)
    known = [read_lemma(problem.net, lemma) for lemma in whole["lemmas"]] + clauses
    for clause in clauses:
        kept = {
            problem.net.transitions[t].name: _shown(
                breaking(problem, clause, known, t), watch, prover
            )
            for t in may_break(problem, clause)
        }
        whole["lemmas"].append({**written_lemma(problem.net, clause), "kept": kept})
    return whole


def _shown(problem: Problem, watch: Watch, prover: Prover) -> Dict[str, Any]:
    found = Prover(problem, watch, prover).prove()
    if isinstance(found, Candidate):
        raise LimitError("not decided: the invariant that z3 found could not be proven")
    return dict(found)


def _clauses(formula: Formula) -> List[Tuple[Atom, ...]]:
    """The disjunctions of inequalities which together are the formula."""
    if isinstance(formula, Atom):
        return [(formula,)]
    if isinstance(formula, All):
        found = [clause for part in formula.parts for clause in _clauses(part)]
    else:
        found = [()]
        for part in formula.parts:
            found = [(*one, *other) for one in found for other in _clauses(part)]
    if len(found) > MOST_CLAUSES:
        raise LimitError("not decided: the invariant has more than %d clauses" % MOST_CLAUSES)
    return found


class _Spacer:
    """The problem as rules of z3: a relation over the counts of all places holds in the first
    marking, and after every firing from where it holds.

    :param z3: the library.
    """

    def __init__(self, z3: Any, problem: Problem, watch: Watch) -> None:
        self._z3, self._net, self._watch = z3, problem.net, watch
        self._context = z3.Context()
        whole, truth = z3.IntSort(self._context), z3.BoolSort(self._context)
        self._counts = [z3.Const("m%d" % p, whole) for p in range(len(self._net.places))]
        self._solver = solver = z3.Fixedpoint(ctx=self._context)
        solver.set(engine="spacer", **dict.fromkeys(_AS_WRITTEN, False))
        self._reached = z3.Function("reached", *[whole] * len(self._counts), truth)
        self._bad = z3.Const("bad", truth)
        solver.register_relation(self._reached, self._bad.decl())
        solver.declare_var(*self._counts)
        start = [z3.IntVal(n, self._context) for n in self._net.initial_marking]
        solver.rule(self._reached(*start), [], "start")
        for t in problem.transitions:
            watch.step("firings written as rules", t)
            effect = dict(self._net.effect(t))
            after = [n + effect[p] if p in effect else n for p, n in enumerate(self._counts)]
            needs = (*guard(self._net, t), *problem.needs(t))
            solver.rule(self._reached(*after), self._where(needs), str(t))
        solver.rule(self._bad, self._where(problem.facts), "bad")

    def ask(self) -> Union[Formula, List[int]]:
        """An invariant that excludes all bad markings, or firings that lead to one.

        :raises LimitError: z3 has no answer, or an unusual one.
        """
        z3, answers = self._z3, [None]
        worker = threading.Thread(target=self._query, args=(answers,), daemon=True)
        worker.start()
        try:
            while worker.is_alive():
                self._watch.step("places in the rules of z3", len(self._counts))
                worker.join(0.05)
        except Exception:  # z3 does not look at the watch
            self._context.interrupt()
            worker.join()
            raise
        if answers[0] == z3.unsat:
            return self._read(self._solver.get_cover_delta(-1, self._reached))
        if answers[0] != z3.sat:
            raise LimitError("not decided: z3 has no answer")
        names = self._solver.get_rule_names_along_trace()
        return [int(name) for name in map(str, reversed(names)) if name.isdecimal()]

    def _query(self, answers: List[Any]) -> None:
        with suppress(self._z3.Z3Exception):  # it has no answer, or was interrupted
            answers[0] = self._solver.query(self._bad)

    def _where(self, formulas: Iterable[Formula]) -> List[Any]:
        return [self._reached(*self._counts), *map(self._written, formulas)]

    def _written(self, formula: Formula) -> Any:
        """A formula in z3."""
        z3 = self._z3
        if isinstance(formula, Atom):
            terms = [weight * self._counts[p] for p, weight in formula.terms]
            return z3.Sum(terms) >= formula.least if terms else self._truth(formula.least <= 0)
        parts = list(map(self._written, formula.parts))
        if not parts:
            return self._truth(isinstance(formula, All))
        return (z3.And if isinstance(formula, All) else z3.Or)(parts)

    def _truth(self, value: bool) -> Any:
        return self._z3.BoolVal(value, self._context)

    def _read(self, e: Any) -> Formula:
        """A formula of z3."""
        z3 = self._z3
        if z3.is_not(e):
            return opposite(self._read(e.arg(0)))
        if z3.is_and(e) or z3.is_true(e):
            return All(tuple(map(self._read, e.children())))
        if z3.is_or(e) or z3.is_false(e):
            return Some(tuple(map(self._read, e.children())))
        if not (z3.is_le(e) or z3.is_lt(e) or z3.is_ge(e) or z3.is_gt(e) or z3.is_eq(e)):
            raise LimitError("not decided: z3 answers with %s" % e.decl().name())
        sums: Dict[int, int] = {}
        self._add(e.arg(0), 1, sums)
        self._add(e.arg(1), -1, sums)
        least = -sums.pop(-1, 0)
        atom = Atom(tuple((p, weight) for p, weight in sums.items() if weight), least)
        if z3.is_gt(e) or z3.is_le(e):
            atom = atom._replace(least=least + 1)
        if z3.is_eq(e):
            return All((atom, opposite(atom._replace(least=least + 1))))
        return opposite(atom) if z3.is_lt(e) or z3.is_le(e) else atom

    def _add(self, e: Any, times: int, sums: Dict[int, int]) -> None:
        """Add a linear sum of z3 to one of places; the constant has the key -1."""
        z3 = self._z3
        if z3.is_var(e):
            p = z3.get_var_index(e)
            sums[p] = sums.get(p, 0) + times
        elif z3.is_int_value(e):
            sums[-1] = sums.get(-1, 0) + times * e.as_long()
        elif z3.is_mul(e) and z3.is_int_value(e.arg(0)) and e.num_args() == 2:
            self._add(e.arg(1), times * e.arg(0).as_long(), sums)
        elif z3.is_add(e) or z3.is_sub(e):
            self._add(e.arg(0), times, sums)
            for part in e.children()[1:]:
                self._add(part, -times if z3.is_sub(e) else times, sums)
        else:
            raise LimitError("not decided: z3 answers with %s" % e.decl().name())
