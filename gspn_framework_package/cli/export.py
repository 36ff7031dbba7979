"""``gspn export``: writes recorded runs as messages that other tools read."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import time
from typing import Any, Dict, List, Mapping, Sequence, Set

from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.cli.plan_output import refuse_existing
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.execution.event_log import LogFile, log_files
from gspn_framework_package.formats.foxglove import foxglove_layout
from gspn_framework_package.formats.source import write_bytes
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.ros.recorded_messages import RecordedMessage, recorded_messages

BETWEEN = 1_000
"""Number of messages between two reports of progress."""


OPTIONS: Arguments = {
    Argument("logs", "LOG", nargs="+"): (
        "event logs, or folders of them; if there are several logs of a run, each supplies the "
        "messages of its own robot"
    ),
    Argument("--bag", "FILE"): "write a rosbag, for rosbag and PlotJuggler",
    Argument("--mcap", "FILE"): "write an MCAP file, for Foxglove",
    Argument("--csv", "FILE"): "write a table of what each robot did, and when it began",
    Argument("--foxglove-layout", "FILE"): (
        "write a layout for Foxglove that shows these robots and places (.json)"
    ),
    "--json": "print what was written as JSON",
}

EPILOG = (
    "Topics: /fired_transitions, and marking, team_state and robot_activity in the namespace "
    "of each robot. --bag and --mcap need the Python libraries rosbags and mcap, but no ROS."
)


def run(args: argparse.Namespace) -> int:
    """Write the files."""
    outputs = [path for path in (args.bag, args.mcap, args.csv, args.foxglove_layout) if path]
    if not outputs:
        raise UsageError(
            "there is nothing to write", hint="give --bag, --mcap, --csv or --foxglove-layout"
        )
    if len(set(map(os.path.abspath, outputs))) < len(outputs):
        raise UsageError("two outputs have the same name", hint="give each its own file")
    for path in outputs:
        refuse_existing(path)
    from gspn_framework_package.formats.message_files import (
        BagFile,
        CsvFile,
        Encoder,
        McapFile,
        MessageFile,
    )

    logs = [LogFile(path) for path in log_files(args.logs)]
    encoder = Encoder() if args.bag or args.mcap else None
    counts: Dict[str, int] = {}
    began = time.monotonic()
    with contextlib.ExitStack() as stack:
        files: List[MessageFile] = []
        if args.bag and encoder is not None:
            files.append(stack.enter_context(BagFile(args.bag, encoder)))
        if args.mcap and encoder is not None:
            files.append(stack.enter_context(McapFile(args.mcap, encoder)))
        if args.csv:
            files.append(stack.enter_context(CsvFile(args.csv)))
        progress = stack.enter_context(ProgressLine())
        shown = _Shown()
        for number, message in enumerate(recorded_messages(logs), 1):
            for file in files:
                file.write(*message)
            shown.note(message)
            counts[message.kind] = counts.get(message.kind, 0) + 1
            if number % BETWEEN == 0:
                progress("messages", number, time.monotonic() - began)
    cut = [log.path for log in logs if log.cut]
    written = [path for path in outputs if path != args.foxglove_layout]
    try:
        if args.foxglove_layout:
            layout = json.dumps(shown.layout(), indent=2).encode() + b"\n"
            write_bytes(args.foxglove_layout, layout)
            written = outputs
    finally:  # the other files are written even if this one fails
        _print(written, counts, cut, args.json)
    return 0


def _print(
    written: Sequence[str], counts: Mapping[str, int], cut: Sequence[str], as_json: bool
) -> None:
    if as_json:
        print(json.dumps({"files": written, "messages": counts, "cut": cut}, indent=2))
        return
    for path in cut:
        print("note: omitting the last line of %s, which was cut off" % path)
    for kind, count in sorted(counts.items()):
        print("%8d %s" % (count, kind))
    print("written: %s" % ", ".join(written))


class _Shown:
    """The content of a layout: the robots, and the places of the first net."""

    def __init__(self) -> None:
        self._robots: Set[str] = set()
        self._places: List[str] = []
        self._namespace = ""

    def note(self, message: RecordedMessage) -> None:
        """Process the next message."""
        if message.kind == "RobotActivity":
            self._robots.add(message.fields["robot"])
        elif message.kind == "Marking" and not self._places:
            self._places = message.fields["places"]
            self._namespace = message.topic[: -len("/marking")]

    def layout(self) -> Dict[str, Any]:
        """The layout, as a JSON object."""
        return foxglove_layout(sorted(self._robots), self._places, self._namespace)
