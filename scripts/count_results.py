#!/usr/bin/env python3
"""Add up JUnit result files: print ``PASSED FAILED SKIPPED``, and on stderr what failed.

Used by run_tests. A file that is empty or cut counts as one failure: its test runner has died.
"""

import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path


def count(path):
    """Return (passed, failed, skipped, names of failed) of one result file."""
    try:
        root = ElementTree.parse(str(path)).getroot()
    except (ElementTree.ParseError, OSError) as error:
        return 0, 1, 0, ["{}: no readable result: {}".format(path.name, error)]
    tests = failed = skipped = 0
    names = []
    for suite in root.iter("testsuite"):
        cases = suite.findall("testcase")
        broken = [case for case in cases if {"failure", "error"} & {part.tag for part in case}]
        tests += max(int(suite.get("tests", 0)), len(cases))
        skipped += int(suite.get("skipped", suite.get("skip", 0)) or 0)
        # a suite may report an error that belongs to no case of its (rostest: a node that died)
        reported = int(suite.get("failures", 0)) + int(suite.get("errors", 0))
        failed += max(reported, len(broken))
        names += ["{}.{}".format(case.get("classname"), case.get("name")) for case in broken]
        if reported > len(broken):
            names.append("{}: {} more".format(path.name, reported - len(broken)))
    return max(tests - failed - skipped, 0), failed, skipped, names


def main():
    """Count the files and folders named on the command line."""
    files = []
    for argument in map(Path, sys.argv[1:]):
        files += sorted(argument.rglob("*.xml")) if argument.is_dir() else [argument]
    totals = [0, 0, 0]
    for path in files:
        passed, failed, skipped, names = count(path)
        totals = [totals[0] + passed, totals[1] + failed, totals[2] + skipped]
        for name in names:
            print("failed: " + name, file=sys.stderr)
    print(*totals)


if __name__ == "__main__":
    main()
