"""Whatever a verb is given to read, it says in one line what is wrong and exits with 2: pipes and
devices at once, and what is nested deeply without running out of stack."""

import os
import socket

import pytest

from gspn_framework_package.cli.main import main

PATROL = "plans/patrol"

VERBS = {
    "check": ["check", "X"],
    "run": ["run", "X"],
    "simulate": ["simulate", "X", "--time", "1"],
    "analyse": ["analyse", "X"],
    "plot": ["plot", "X", "-o", "out.png"],
    "draw": ["draw", "X", "-o", "out.svg"],
    "convert": ["convert", "X", "out.pnml"],
    "diff": ["diff", PATROL, "X"],
    "explain": ["explain", "X"],
    "export": ["export", "X", "--csv", "out.csv"],
    "compare": ["compare", PATROL, "X"],
    "verify": ["verify", "X"],
    "fit": ["fit", PATROL, "X", "-o", "out.json"],
    "improve": ["improve", PATROL, "X", "--reach", "deadlock", "-o", "out.json"],
    "optimise": ["optimise", "X", "--reach", "deadlock"],
    "build": ["build", "X", "-o", "built"],
    "film": ["film", "out.mp4", "--recording", "X"],
    "room": ["room", "X"],
    "keys": ["keys", "show", "X"],
    "token file": ["serve", PATROL, "--port", "0", "--token-file", "X"],
    "team key": ["pause", "--team-key-file", "X"],
    "task": ["submit", "T", "--data", "X", "--connect", "tcp/127.0.0.1:1"],
}


def bad_files(folder):
    os.mkfifo(folder / "pipe")
    os.mkfifo(folder / "pipe.json")
    os.mkfifo(folder / "pipe.xml")
    os.mkfifo(folder / "pipe.bag")
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(str(folder / "socket"))
    (folder / "zeros.jsonl").write_bytes(b"\0" * 1000)
    (folder / "deep.json").write_text('{"net": %s%s, "actions": {}}' % ("[" * 500, "]" * 500))
    deep = '{"format": "gspn_log", "x": %s%s}\n' % ("[" * 100_000, "]" * 100_000)
    (folder / "deep.jsonl").write_text(deep)
    (folder / "deep.xml").write_text("<pnml>%s%s</pnml>" % ("<a>" * 5000, "</a>" * 5000))
    (folder / "deep.yaml").write_text("a: %s%s" % ("[" * 5000, "]" * 5000))
    os.symlink("loop", folder / "loop")
    return listening


@pytest.mark.parametrize("verb", VERBS)
def test_bad_input_is_one_line_and_exit_2(tmp_path, monkeypatch, capsys, verb):
    root = os.getcwd()
    monkeypatch.chdir(tmp_path)
    os.symlink(os.path.join(root, "plans"), "plans")
    (tmp_path / "bad").mkdir()
    with bad_files(tmp_path / "bad"):
        for name in sorted(os.listdir("bad")) + ["none", "/dev/zero"]:
            words = [os.path.join("bad", name) if word == "X" else word for word in VERBS[verb]]
            assert main(words) == 2, (words, capsys.readouterr())
            told = capsys.readouterr().err.strip().splitlines()
            assert len(told) == 1 and told[0].startswith("gspn: error: "), (words, told)


@pytest.mark.parametrize(
    "words",
    [
        ["plot", "plans/tokens", "-o", "full.png"],
        ["convert", "plans/tokens", "/dev/full", "--to", "pnml"],
        ["simulate", "plans/tokens", "--time", "1", "--replications", "2", "--csv", "/dev/full"],
        ["analyse", "plans/tokens", "--csv", "/dev/full"],
        ["draw", "plans/tokens", "-o", "full.svg"],
    ],
    ids=lambda words: words[0],
)
def test_a_full_disk_is_one_line_and_exit_2(tmp_path, monkeypatch, capsys, words):
    root = os.getcwd()
    monkeypatch.chdir(tmp_path)
    os.symlink(os.path.join(root, "plans"), "plans")
    os.symlink("/dev/full", "full.png")
    os.symlink("/dev/full", "full.svg")
    assert main(words) == 2, capsys.readouterr()
    told = capsys.readouterr().err.strip().splitlines()
    assert "No space left" in told[-1]
