"""A package of somebody else's, which extends gspn_framework_package from outside: one module for
each kind of thing that ``docs/developing.md`` says how to add."""
