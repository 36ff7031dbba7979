"""``gspn report``: the story of a recorded run: who waited for whom and why, and what happened."""

from __future__ import annotations

import argparse
import json
import os

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.cli.plan_output import refuse_existing
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.cli.table import aligned
from gspn_framework_package.fleet.run_story import (
    RunStory,
    length_text,
    longest_waits,
    read_story,
    story_to_json,
    time_text,
    waited_for,
)
from gspn_framework_package.fleet.story_page import story_page
from gspn_framework_package.formats.source import write_bytes

OPTIONS: Arguments = {
    Argument("log", "LOG"): "an event log of the run",
    Argument("-o --output", "FILE"): "write it as one HTML file, to look at and to send",
    Argument("--link", "URL"): (
        "in that file, link each moment to its replay on a page with this address, such as "
        "http://HOST:8090/#replay"
    ),
    Argument("--most", "N", numbers.whole(1, 10_000), 10): (
        "how many waits and moments to print (10)"
    ),
    "--json": "print it as JSON",
}


def run(args: argparse.Namespace) -> int:
    """Read the log, and write or print its story."""
    if args.output:
        refuse_existing(args.output)
    with ProgressLine() as progress:
        story = read_story(args.log, progress)
    if args.output:
        page = story_page(story, os.path.basename(args.log), args.link or "")
        write_bytes(args.output, page.encode("utf-8"))
    if args.json:
        print(json.dumps(story_to_json(story, args.most)))
    elif args.output:
        print("the story of run %s is in %s" % (story.run, args.output))
    else:
        _print(story, args.most)
    return 0


def _print(story: RunStory, most: int) -> None:
    print(
        "run %s of plan %s: %s, %d robots, %d firings"
        % (story.run, story.plan, length_text(story.seconds), len(story.spells), story.firings)
    )
    rows = [
        [row["robot"], length_text(row["seconds"]), str(row["waits"]), ", ".join(row["by"])]
        for row in waited_for(story)
    ]
    if rows:
        print("\n".join(["", *aligned([["waited for", "time", "waits", "by"], *rows])]))
    waits = longest_waits(story, most)
    if waits:
        print("\nthe longest waits")
    for wait in waits:
        print("%s  %s %s" % (time_text(wait.begin), wait.robot, wait.text()))
    if story.moments:
        print("\nwhat happened%s" % (" last" if len(story.moments) > most else ""))
    for moment in story.moments[-most:]:
        parts = (time_text(moment.at), moment.what, moment.where, moment.detail)
        print(("%s  %s, %s: %s" % parts).rstrip(": "))
