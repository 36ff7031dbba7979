"""The sorts, terms and guards of a coloured PNML net (ISO/IEC 15909-2), read into functions of the
values of its variables.

======================  ============================================================================
sorts                   dot, finite and cyclic enumerations, ranges of integers, products
colours                 constants, variables, successor and predecessor in a cyclic enumeration,
                        tuples
multisets               ``numberof``, ``all``, ``empty``, ``add``, ``subtract``, and tuples of them
guards                  ``and``, ``or``, ``not``, ``imply``, equality and inequality, comparisons of
                        colours by their order
======================  ============================================================================

Anything else (partitions, operators that the file defines, integers, strings, lists) is refused
with its line.
"""

from __future__ import annotations

import itertools
import operator
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    FrozenSet,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    NoReturn,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from gspn_framework_package.formats.xml_tree import child, line_of, tag
from gspn_framework_package.model.expression import shorten

if TYPE_CHECKING:
    from lxml import etree

MOST_COLOURS = 500_000
"""Maximum number of colours of a sort whose colours are all named."""

Colour = Any
"""A number (of a constant in its enumeration, or of a range), or a tuple of colours."""

Binding = Dict[str, Colour]
"""Id of a variable -> its colour."""

ColourCounts = Iterable[Tuple[Colour, int]]
"""Colours, each with a number."""


class Basic(NamedTuple):
    """A sort whose colours have a number each: dots, an enumeration, or a range of integers.

    :ivar kind: the element that declares it.
    :ivar names: the names of its colours.
    :ivar first: the number of the first one.
    """

    kind: str
    names: Tuple[str, ...]
    first: int = 0

    @property
    def size(self) -> int:
        """The number of its colours."""
        return len(self.names)

    def colours(self) -> Iterable[Colour]:
        """Its colours, in order."""
        return range(self.first, self.first + len(self.names))

    def has(self, colour: Colour) -> bool:
        """Whether a number is one of its colours."""
        return 0 <= colour - self.first < len(self.names)

    def text(self, colour: Colour) -> str:
        """The suffix of a place's name; "" for a dot."""
        return "" if self.kind == "dot" else "." + self.names[colour - self.first]


class Product(NamedTuple):
    """A sort of tuples."""

    parts: Tuple[Sort, ...]

    @property
    def size(self) -> int:
        """The number of its colours."""
        total = 1
        for part in self.parts:
            total *= part.size
        return total

    def colours(self) -> Iterable[Colour]:
        """Its colours, in order."""
        return itertools.product(*(part.colours() for part in self.parts))

    def has(self, colour: Colour) -> bool:
        """Whether a tuple is one of its colours."""
        return all(part.has(c) for part, c in zip(self.parts, colour))

    def text(self, colour: Colour) -> str:
        """The suffix of a place's name."""
        return "".join(part.text(c) for part, c in zip(self.parts, colour))


Sort = Union[Basic, Product]

DOT = Basic("dot", ("dot",))
_RANGE, _CYCLE = "finiteintrange", "cyclicenumeration"


class ColourTerm(NamedTuple):
    """A term: its sort, its variables, the most colours that it can have, its value as a multiset
    and, of a term with one colour, that colour."""

    sort: Sort
    variables: FrozenSet[str]
    size: int
    many: Callable[[Binding], ColourCounts]
    one: Optional[Callable[[Binding], Colour]] = None


class ColourGuard(NamedTuple):
    """A condition on colours: its variables, and whether it holds for their values."""

    variables: FrozenSet[str]
    holds: Callable[[Binding], bool]


class ColourTerms:
    """Reads the declarations of a net, and terms over what they declare.

    :param net: the element with the declarations.
    :param fail: raises the error: (message, element, line, hint).
    :ivar what: the element of the net whose terms are read, for messages.
    :ivar variables: id -> sort, in the order of the declarations.
    :raises GspnError: something is not covered, or names what is not declared.
    """

    def __init__(self, net: etree._Element, fail: Callable[..., NoReturn]) -> None:
        self._fail = fail
        self.what = "declarations"
        self._sorts: Dict[str, etree._Element] = {}
        self._known_sorts: Dict[str, Optional[Sort]] = {}
        self._constants: Dict[str, Tuple[Sort, Colour]] = {}
        self.variables: Dict[str, Sort] = {}
        self._declare(net)

    # -- declarations and sorts

    def _declare(self, net: etree._Element) -> None:
        declared = [
            declaration
            for element in net.iter("{*}declarations")
            for declaration in element
            if tag(declaration)
        ]
        variables = []
        for declaration in declared:
            kind = tag(declaration)
            if kind == "namedsort":
                self._sorts[declaration.get("id", "")] = declaration
            elif kind == "variabledecl":
                variables.append(declaration)
            else:
                self._refuse(declaration, ["namedsort", "variabledecl"])
        for name, declaration in self._sorts.items():
            self._named_sort(name, declaration)
        for declaration in variables:
            self.variables[declaration.get("id", "")] = self.sort(self._only(declaration))

    def _named_sort(self, name: Optional[str], at: etree._Element) -> Sort:
        if name not in self._sorts:
            self.wrong(at, "there is no sort '%s'" % shorten(name or ""))
        if name not in self._known_sorts:
            self._known_sorts[name] = None
            self._known_sorts[name] = self.sort(self._only(self._sorts[name]))
        found = self._known_sorts[name]
        if found is None:
            self.wrong(at, "the sort '%s' contains itself" % shorten(name))
        return found

    def sort(self, element: etree._Element) -> Sort:
        """The sort that an element is, or names."""
        kind = tag(element)
        if kind == "dot":
            return DOT
        if kind == "usersort":
            return self._named_sort(element.get("declaration"), element)
        if kind == "productsort":
            return Product(tuple(self.sort(part) for part in element if tag(part)))
        if kind == _RANGE:
            first, last = self._number(element, "start"), self._number(element, "end")
            if last - first + 1 > MOST_COLOURS:
                self.wrong(element, "the range has %d integers" % (last - first + 1))
            return Basic(kind, tuple(map(str, range(first, last + 1))), first)
        if kind in ("finiteenumeration", _CYCLE):
            constants = [part for part in element if tag(part)]
            for constant in constants:
                if tag(constant) != "feconstant":
                    self._refuse(constant, ["feconstant"])
            names = [(constant.get("name") or "").strip() for constant in constants]
            if not all(names) or len(set(names)) < len(names):
                names = [constant.get("id", "") for constant in constants]
            sort = Basic(kind, tuple(names))
            for colour, constant in enumerate(constants):
                self._constants[constant.get("id", "")] = sort, colour
            return sort
        return self._refuse(
            element,
            ["dot", "usersort", "productsort", _RANGE, "finiteenumeration", _CYCLE],
        )

    # -- terms

    def term(self, element: etree._Element) -> ColourTerm:
        """Read a term for colours."""
        kind = tag(element)
        if kind == "dotconstant":
            return constant(DOT, 0)
        if kind == "variable":
            name = element.get("refvariable", "")
            if name not in self.variables:
                self.wrong(element, "there is no variable '%s'" % shorten(name))
            return _single(self.variables[name], frozenset([name]), lambda b: b[name])
        if kind == "useroperator":
            name = element.get("declaration", "")
            if name not in self._constants:
                self.wrong(element, "there is no constant '%s'" % shorten(name))
            return constant(*self._constants[name])
        if kind == "finiteintrangeconstant":
            sort, colour = self.sort(self._only(element)), self._number(element, "value")
            if not sort.has(colour):
                self.wrong(element, "%d is not in its range" % colour)
            return constant(sort, colour)
        if kind in ("all", "empty"):
            sort = self.sort(self._only(element))
            if sort.size > MOST_COLOURS:
                self.wrong(element, "its sort has %s colours" % format(sort.size, ","))
            found = [(colour, 1) for colour in sort.colours()] if kind == "all" else []
            return ColourTerm(sort, frozenset(), len(found), lambda b: found)
        if kind in ("successor", "predecessor"):
            return self._next(element, 1 if kind == "successor" else -1)
        if kind == "tuple":
            return _tuple([self.term(part) for part in self._subterms(element)])
        if kind in ("numberof", "scalarproduct"):
            return self._times(element)
        if kind in ("add", "subtract"):
            return self._sum(element, 1 if kind == "add" else -1)
        return self._refuse(
            element,
            [
                *("dotconstant", "variable", "useroperator", "finiteintrangeconstant", "tuple"),
                *("all", "empty", "successor", "predecessor", "numberof", "scalarproduct"),
                *("add", "subtract"),
            ],
        )

    def _next(self, element: etree._Element, step: int) -> ColourTerm:
        (part,) = self._subterms(element, 1)
        inner = self.term(part)
        sort, one = inner.sort, inner.one
        if not isinstance(sort, Basic) or sort.kind != _CYCLE or one is None:
            self.wrong(element, "only a colour of a cyclic enumeration has a next one")
        size = sort.size
        return _single(sort, inner.variables, lambda b: (one(b) + step) % size)

    def _times(self, element: etree._Element) -> ColourTerm:
        number, part = self._subterms(element, 2)
        if tag(number) != "numberconstant":
            self._refuse(number, ["numberconstant"])
        count, inner = self._number(number, "value"), self.term(part)
        if count < 0:
            self.wrong(number, "%d is below 0" % count)
        if count == 1:
            return inner._replace(one=None)
        many = inner.many
        return inner._replace(one=None, many=lambda b: [(c, n * count) for c, n in many(b)])

    def _sum(self, element: etree._Element, sign: int) -> ColourTerm:
        found = self._subterms(element)
        parts = [self.term(part) for part in found]
        for part, inside in zip(parts, found):
            self.demand_sort(inside, part.sort, parts[0].sort)
        signs = [1, *[sign] * (len(parts) - 1)]

        def many(binding: Binding) -> ColourCounts:
            total: Dict[Colour, int] = {}
            for part, factor in zip(parts, signs):
                for colour, count in part.many(binding):
                    total[colour] = total.get(colour, 0) + factor * count
            return total.items()

        variables = frozenset().union(*(part.variables for part in parts))
        return ColourTerm(parts[0].sort, variables, sum(part.size for part in parts), many)

    # -- guards

    def conjuncts(self, element: etree._Element) -> List[ColourGuard]:
        """Read a guard as conditions that must all hold."""
        if tag(element) == "and":
            return [g for part in self._subterms(element) for g in self.conjuncts(part)]
        return [self._guard(element)]

    def _guard(self, element: etree._Element) -> ColourGuard:
        kind = tag(element)
        if kind in _JOINED:
            parts = [self._guard(part) for part in self._subterms(element, _JOINED[kind])]
            variables = frozenset().union(*(part.variables for part in parts))
            tests = [part.holds for part in parts]
            if kind == "not":
                return ColourGuard(variables, lambda b: not tests[0](b))
            if kind == "imply":
                return ColourGuard(variables, lambda b: not tests[0](b) or tests[1](b))
            every = all if kind == "and" else any
            return ColourGuard(variables, lambda b: every(test(b) for test in tests))
        if kind == "booleanconstant":
            value = element.get("value", "").strip().lower() == "true"
            return ColourGuard(frozenset(), lambda b: value)
        if kind in _COMPARED:
            compare = _COMPARED[kind]
            first, second = (self._colour(part) for part in self._subterms(element, 2))
            self.demand_sort(element, second.sort, first.sort)
            one, other = first.one, second.one
            assert one is not None and other is not None
            return ColourGuard(
                first.variables | second.variables, lambda b: bool(compare(one(b), other(b)))
            )
        return self._refuse(element, [*_JOINED, *_COMPARED, "booleanconstant"])

    def _colour(self, element: etree._Element) -> ColourTerm:
        found = self.term(element)
        if found.one is None:
            self.wrong(element, "a guard compares single colours")
        return found

    # -- errors

    def demand_sort(self, element: etree._Element, sort: Sort, wanted: Sort) -> None:
        """Refuse a term whose colours are not of the sort that is wanted."""
        if not _agree(sort, wanted):
            self.wrong(element, "its colours are of another sort")

    def structure(self, element: etree._Element, label: str) -> Optional[etree._Element]:
        """The content of the ``structure`` of an element's label; None if there is no label."""
        outer = child(element, label)
        if outer is None:
            return None
        structure = child(outer, "structure")
        if structure is None:
            self.wrong(outer, "its <%s> has no <structure>" % label)
        return self._only(structure)

    def _only(self, element: etree._Element) -> etree._Element:
        """The only element inside."""
        inside = [part for part in element if tag(part)]
        if len(inside) != 1:
            self.wrong(element, "<%s> needs one element inside" % tag(element))
        return inside[0]

    def _subterms(self, element: etree._Element, number: int = 0) -> List[etree._Element]:
        inside = [part for part in element if tag(part)]
        for part in inside:
            if tag(part) != "subterm":
                self._refuse(part, ["subterm"])
        if not inside or (number and len(inside) != number):
            self.wrong(element, "<%s> needs %s subterms" % (tag(element), number or "some"))
        return [self._only(part) for part in inside]

    def _number(self, element: etree._Element, attribute: str) -> int:
        text = (element.get(attribute) or "").strip()
        if not text.lstrip("-").isdigit() or not text.isascii() or len(text) > 15:
            self.wrong(element, "'%s' is not a whole number" % shorten(text))
        return int(text)

    def wrong(self, element: etree._Element, message: str) -> NoReturn:
        """Raise an error with the line of an element inside of ``what``."""
        self._fail(message, self.what, line_of(element), None)

    def _refuse(self, element: etree._Element, known: Iterable[str]) -> NoReturn:
        self._fail(
            "a coloured net: <%s> in it is not unfolded" % shorten(tag(element), 40),
            self.what,
            line_of(element),
            "unfolded here: %s" % ", ".join(known),
        )


_JOINED = {"and": 0, "or": 0, "not": 1, "imply": 2}
"""Operators that join guards -> the number of subterms; 0: any."""

_COMPARED: Mapping[str, Callable[[Colour, Colour], Any]] = {
    "equality": operator.eq,
    "inequality": operator.ne,
    "lessthan": operator.lt,
    "lessthanorequal": operator.le,
    "greaterthan": operator.gt,
    "greaterthanorequal": operator.ge,
}


def _agree(first: Sort, second: Sort) -> bool:
    """Whether two sorts are the same except for the bounds of ranges."""
    if isinstance(first, Product) and isinstance(second, Product):
        return len(first.parts) == len(second.parts) and all(map(_agree, first.parts, second.parts))
    if isinstance(first, Basic) and isinstance(second, Basic):
        return first == second or first.kind == second.kind == _RANGE
    return False


def _single(sort: Sort, variables: FrozenSet[str], one: Callable[[Binding], Colour]) -> ColourTerm:
    return ColourTerm(sort, variables, 1, lambda b: ((one(b), 1),), one)


def constant(sort: Sort, colour: Colour) -> ColourTerm:
    """The term that always is this colour."""
    return _single(sort, frozenset(), lambda b: colour)


def _tuple(parts: Sequence[ColourTerm]) -> ColourTerm:
    """A tuple; where parts are multisets, all tuples of their colours."""
    sort = Product(tuple(part.sort for part in parts))
    variables = frozenset().union(*(part.variables for part in parts))
    ones = [part.one for part in parts if part.one is not None]
    if len(ones) == len(parts):
        return _single(sort, variables, lambda b: tuple(one(b) for one in ones))
    size = 1
    for part in parts:
        size *= part.size

    def many(binding: Binding) -> ColourCounts:
        for chosen in itertools.product(*(list(part.many(binding)) for part in parts)):
            count = 1
            for _, number in chosen:
                count *= number
            yield tuple(colour for colour, _ in chosen), count

    return ColourTerm(sort, variables, size, many)
