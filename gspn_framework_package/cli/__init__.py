"""The command line: one module per verb, started by :mod:`gspn_framework_package.cli.main`."""
