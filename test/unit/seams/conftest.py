"""A package of somebody else's, ``toys``, and the tables to which its records are added."""

import importlib
import sys
from pathlib import Path

import pytest
from seams_table import SEAMS

from gspn_framework_package.execution.plan_modules import allow_modules


@pytest.fixture(autouse=True)
def toys(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    allow_modules(["toys"])
    yield
    allow_modules(())
    for name in [name for name in sys.modules if name.split(".")[0] == "toys"]:
        del sys.modules[name]


@pytest.fixture
def add(monkeypatch):
    """Adds records under a key to the tables of what is added, until the test ends."""

    def add(what, *keys_and_records):
        for where, (key, record) in zip(SEAMS[what], keys_and_records):
            file, name = where.split(": ")
            module = "gspn_framework_package." + file[:-3].replace("/", ".")
            monkeypatch.setitem(getattr(importlib.import_module(module), name), key, record)

    return add


@pytest.fixture
def toy_kind(add):
    from toys import toy_kind

    add("a kind of action", ("say", toy_kind.SayAction), (toy_kind.SayAction, toy_kind.ready))
    return toy_kind
