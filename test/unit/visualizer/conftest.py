"""What tests of the page begin with."""

import pytest
from forked_workers import forked_workers

STARTED = ("test_page_analysis", "test_page_edit_check")
"""Modules whose subject is the processes themselves, which start as for a user."""


@pytest.fixture(scope="module", autouse=True, name="workers_are_forked")
def _workers_are_forked(request):
    if request.module.__name__ in STARTED:
        yield
    else:
        with forked_workers():
            yield
