"""Finds the commands and the files in the documents, for the tests that run them."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import Iterator, List, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "gspn_framework_package"
SHELL = ("sh", "bash", "shell", "console")

_FENCE = re.compile(r"^(\s*)(```+|:::+)(.*)$")
_EXIT_CODE = re.compile(r"exit code (\d+)")


class File(NamedTuple):
    """A file that a document writes down: a code block with a caption or, where GitHub shows the
    document, with a file name after the language."""

    path: str
    text: str


class Command(NamedTuple):
    """A command of a document: ``words`` after shell quoting, ``line`` as written."""

    document: str
    number: int
    line: str
    comment: str

    @property
    def words(self) -> List[str]:
        return shlex.split(self.line)

    @property
    def exit_code(self) -> int:
        """What the comment beside the command says, 0 where it says nothing."""
        said = _EXIT_CODE.search(self.comment)
        return int(said.group(1)) if said else 0

    def __str__(self) -> str:
        return "%s:%d: %s" % (self.document, self.number, self.line)


def documents() -> List[Path]:
    """Every document that a user reads."""
    return [
        ROOT / "README.md",
        *sorted((ROOT / "docs").glob("*.md")),
        *sorted((ROOT / "plans").glob("*/README.md")),
    ]


def steps(document: Path) -> Iterator[object]:
    """The files and the commands of a document, in order."""
    lines = document.read_text(encoding="utf-8").splitlines()
    name = str(document.relative_to(ROOT))
    number = 0
    while number < len(lines):
        fence = _FENCE.match(lines[number])
        if fence:
            begin = number + 1
            end = begin
            while end < len(lines) and lines[end].strip() != fence.group(2):
                end += 1
            if fence.group(2).startswith("`"):
                yield from _block(name, fence.group(3).strip(), begin, lines[begin:end])
            number = end + 1
        elif lines[number].startswith("    ") and number and not lines[number - 1].strip():
            end = number
            while end < len(lines) and (lines[end].startswith("    ") or not lines[end].strip()):
                end += 1
            yield from _commands(name, number, lines[number:end])
            number = end
        else:
            number += 1


def _block(name: str, info: str, begin: int, body: List[str]) -> Iterator[object]:
    if info.startswith("{code-block}"):
        caption = [
            line.split(":caption:", 1)[1].strip() for line in body if line.startswith(":caption:")
        ]
        if caption:
            text = [line for line in body if not line.startswith(":")]
            yield File(caption[0], "\n".join(text).strip() + "\n")
    elif len(info.split()) == 2:
        yield File(info.split()[1], "\n".join(body) + "\n")
    elif info in SHELL or (not info and _looks_like_shell(body)):
        yield from _commands(name, begin, body)


def _looks_like_shell(body: List[str]) -> bool:
    starts = (
        "./",
        "python3 ",
        "gspn ",
        "ros",
        "source ",
        "sudo ",
        "git ",
        "catkin_make",
        "mkdir ",
        "export ",
    )
    lines = [line for line in body if line.strip()]
    return bool(lines) and lines[0].lstrip("$ ").startswith(starts)


def _commands(name: str, begin: int, body: List[str]) -> Iterator[Command]:
    joined, first = "", 0
    for offset, line in enumerate(body):
        text = line.strip()
        if not joined:
            first = begin + offset + 1
        joined += text[:-1] if text.endswith("\\") else text
        if text.endswith("\\"):
            continue
        command, _, comment = joined.partition(" #")
        joined = ""
        command = command.strip()
        if command.startswith("$ "):
            command = command[2:]
        if command and not command.startswith("#"):
            yield Command(name, first, command, comment)


def first_commands(document: Path, count: int, folder: Path) -> List[str]:
    """The lines of a document up to the first so many commands of the program, without those that
    need a checkout or ROS; the files among them are written into the folder."""
    lines: List[str] = []
    for step in steps(document):
        if isinstance(step, File):
            path = folder / step.path
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(step.text, encoding="utf-8")
        elif step.words[0] == "gspn" or step.words[:3] == ["python3", "-m", PACKAGE]:
            if "serve" not in step.words:  # ends at Ctrl-C
                ends = " || [ $? -eq %d ]" % step.exit_code if step.exit_code else ""
                lines.append(step.line + ends)
                count -= 1
        elif step.words[0] in ("mkdir", "cd"):
            lines.append(step.line)
        if not count:
            break
    return lines


if __name__ == "__main__":
    page, number, where = sys.argv[1:]
    print("\n".join(first_commands(Path(page).resolve(), int(number), Path(where))))
