"""What ``docs/developing.md`` says can be added, and the tables that the tests here touch for it."""

SEAMS = {
    "a file format": ["formats/registry.py: FORMATS"],
    "a measure": ["analysis/report_measures.py: MEASURES"],
    "a parameter of `gspn sweep`": ["analysis/sweeps/variation.py: _KINDS"],
    "a verb": ["cli/main.py: VERBS"],
    "a tool for language models": ["cli/mcp_tools.py: TOOLS"],
    "an order of the operator": ["team/orders.py: ORDERS"],
    "an action of your own": [],
    "a kind of action": ["model/action.py: ACTION_KINDS", "execution/local_kinds.py: LOCAL_KINDS"],
    "a source of events": ["model/event.py: SOURCE_KINDS"],
    "a failure rule": ["model/failure.py: FAILURE_KINDS"],
    "a family of durations": ["model/duration.py: FAMILIES"],
}
"""What is added -> the tables that get a record, and nothing else of the package is touched."""
