"""Constants of a net file, which may be defined in terms of each other."""

from __future__ import annotations

from typing import Dict, Mapping

from gspn_framework_package.model.errors import ExpressionError
from gspn_framework_package.model.expression import evaluate, names_in, parse


def resolve_constants(
    definitions: Mapping[str, str], given: Mapping[str, float] = {}
) -> Dict[str, float]:
    """Compute the values of constants that are defined in terms of each other.

    :param definitions: name -> expression.
    :param given: values from outside; they take precedence over a definition of the same name.
    :raises ExpressionError: a definition cannot be read, uses an unknown name, or depends on
        itself.

    >>> resolve_constants({"a": "2*b", "b": "N"}, {"N": 3}) == {"N": 3.0, "a": 6.0, "b": 3.0}
    True
    """
    values = {name: float(value) for name, value in given.items()}
    trees = {}
    for name, text in definitions.items():
        if name not in values:
            try:
                trees[name] = parse(text)
            except ExpressionError as error:
                raise ExpressionError(
                    error.message, element="constant '%s'" % name, hint=error.hint
                ) from None
    open_names: Dict[str, None] = {}  # ordered: the chain of definitions being resolved
    waiting = list(reversed(list(trees)))
    while waiting:
        name = waiting[-1]
        if name in values:
            waiting.pop()
            continue
        if name not in open_names:
            open_names[name] = None
            needed = sorted(n for n in names_in(trees[name]) if n not in values and n in trees)
            looped = [n for n in needed if n in open_names]
            if looped:
                chain = list(open_names)
                ring = chain[chain.index(looped[0]) :] + [looped[0]]
                raise ExpressionError(
                    "constants are defined by each other: %s" % " -> ".join(ring),
                    element="constant '%s'" % looped[0],
                )
            waiting += needed
            if needed:
                continue
        try:
            values[name] = evaluate(trees[name], values)
        except ExpressionError as error:
            raise ExpressionError(
                error.message, element="constant '%s'" % name, hint=error.hint
            ) from None
        del open_names[name]
        waiting.pop()
    return values
