"""A verb: counts the words that it is given."""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("words", nargs="*", help="what is counted")


def run(args: argparse.Namespace) -> int:
    print(len(args.words))
    return 0
