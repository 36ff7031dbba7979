"""Functions of which some words are replaced.

A function is compiled again in its own module, with the changed text. So a mutant that is made in
this way fails at once when the program changes under it.
"""

from __future__ import annotations
import __future__

import contextlib
import inspect
import textwrap
from functools import lru_cache
from typing import Any, Callable, Dict, Iterator, Sequence, Tuple

Edit = Tuple[Callable[..., Any], str, str]
"""A function, words in it, and what stands in their place."""


@lru_cache(maxsize=None)
def source_of(function: Callable[..., Any]) -> str:
    """The text of a function."""
    return inspect.getsource(function)


@contextlib.contextmanager
def applied(edits: Sequence[Edit]) -> Iterator[None]:
    """The program with these changes."""
    before = [(function, function.__code__) for function, _, _ in edits]
    texts: Dict[Callable[..., Any], str] = {}
    for function, words, others in edits:
        text = texts.get(function) or source_of(function)
        if words not in text:
            raise AssertionError("%s has no '%s'" % (function.__qualname__, words))
        texts[function] = text.replace(words, others)
    try:
        for function, text in texts.items():
            _replace(function, text)
        yield
    finally:
        for function, code in before:
            function.__code__ = code


def _replace(function: Any, text: str) -> None:
    flags = __future__.annotations.compiler_flag
    text = textwrap.dedent(text)
    code = compile(text, "mutant of %s" % function.__qualname__, "exec", flags, True)
    names = dict(function.__globals__)
    exec(code, names)
    function.__code__ = names[function.__name__].__code__
