"""The command line: one module for each verb, started by :mod:`gspn_framework_package.cli.main`."""
