"""The specification of the agreement, ``spec/agreement.tla``: TLC checks small teams, finds the faults
that are put into it, and its names are those of the code. The first two take about 55 s of processor
time, and need TLC (``scripts/check_spec --install``, as ``run_tests`` does)."""

from __future__ import annotations

import dataclasses
import importlib
import re
from pathlib import Path
from typing import Dict, Set

import pytest

from agreement import specification
from agreement.specification import FOLDER, MODULE, MUTANTS
from gspn_framework_package.execution.agreement.state import ReplicaState

needs_tlc = pytest.mark.skipif(bool(specification.why_not()), reason=specification.why_not())
TEXT = MODULE.read_text("utf-8")


@needs_tlc
@pytest.mark.timeout(1200)  # a machine may be busy with other tests
@pytest.mark.parametrize("path", specification.configurations("small"), ids=lambda p: p.stem)
def test_the_protocol_holds_in_every_state_of_a_small_team(path: Path) -> None:
    found = specification.check(path)
    assert (found.broken, found.error) == ("", ""), found.output[-20000:]
    assert found.states == specification.states_of(path), "the figure in %s" % path.name


@needs_tlc
@pytest.mark.timeout(1200)  # a machine may be busy with other tests
@pytest.mark.parametrize("mutant", MUTANTS[:4], ids=lambda mutant: mutant.name)
def test_a_fault_of_the_protocol_is_refuted(mutant: specification.Mutant) -> None:
    """The others: ``scripts/check_spec --mutants``."""
    found = specification.check_mutant(mutant)
    assert found.broken == mutant.broken, found.output[-20000:]


def test_every_fault_can_be_put_into_the_specification() -> None:
    assert [m.name for m in MUTANTS if m.old and TEXT.count(m.old) != 1] == []
    bases = {path.stem for path in FOLDER.glob("*.cfg")}
    assert {mutant.base for mutant in MUTANTS} <= bases


def _table() -> Dict[str, str]:
    """The names of the specification, and of the code beside them, from the README."""
    text = (FOLDER / "README.md").read_text("utf-8").split("## Names")[1]
    rows = re.findall(r"^\| `([^`]+)` \| (?:`([^`]+)`)? *\|", text, re.M)
    assert len(rows) > 40
    return dict(rows)


def _actions() -> Set[str]:
    """The disjuncts of ``Next``."""
    body = TEXT.split("\nNext ==")[1].split("\n\n")[0]
    return set(re.findall(r"(\w+)\(p[,)]", body))


def test_every_action_and_variable_is_in_the_table() -> None:
    variables = re.findall(r"^  (\w+),? +\\\*", TEXT.split("VARIABLES")[1].split("\n\n")[0], re.M)
    assert {"propose", "on_accept", "Spare", "conflict"} <= _actions()
    assert {"state", "sent", "faults"} <= set(variables)
    table = _table()
    assert [name for name in sorted(_actions() | set(variables)) if name not in table] == []


def test_every_name_of_the_table_is_in_the_specification_and_in_the_code() -> None:
    for name, code in _table().items():
        field = name.split(".")[-1]
        assert re.search(r"^\s*%s\b" % re.escape(field), TEXT, re.M), name
        if code:
            module, *path = code.split(".")
            found = importlib.import_module("gspn_framework_package.execution.agreement." + module)
            for step in path:
                fields = getattr(found, "__dataclass_fields__", {})
                assert hasattr(found, step) or step in fields, code
                found = getattr(found, step, None)


def test_the_fields_of_a_process_are_those_of_a_replica() -> None:
    fresh = TEXT.split("\nFresh(id) ==")[1].split("\nup(p)")[0]
    names = set(re.findall(r"^  (\w+) +\|->", fresh, re.M))
    assert len(names) > 20
    known = {field.name for field in dataclasses.fields(ReplicaState)}
    assert {name for name in names - known if "state[p]." + name not in _table()} == set()
