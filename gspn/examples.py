"""``python3 -m gspn.examples`` lists the example plans that come with the package."""

from __future__ import annotations

import os
import sys
from typing import Iterator, Tuple

from gspn_framework_package.formats.example_plans import example_folder, example_names
from gspn_framework_package.formats.json_file import read_json
from gspn_framework_package.formats.plan_file import file_of


def listed_examples() -> Iterator[Tuple[str, str, str]]:
    """Yield each example: its name, what it is, and its folder."""
    for name in example_names():
        folder = example_folder(name)
        yield name, read_json(file_of(folder)).get("description", ""), folder


def main() -> None:
    """Print the examples."""
    for name, about, folder in listed_examples():
        print("%s: %s\n    %s" % (name, about, os.path.relpath(folder)))
    print("\ngspn new --example NAME DIR copies one into a new folder;")
    print("in Python, gspn.example(NAME) is the plan.")


if __name__ == "__main__":
    try:
        main()
        sys.stdout.flush()
    except BrokenPipeError:  # the reader (head, less) has exited; Python flushes again at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
