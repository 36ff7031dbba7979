"""Every command in the documents works, and every link leads somewhere.

What needs no ROS is run, in a folder that holds what the document has written down so far. What
needs ROS is checked against the launch files, scripts and interfaces that it names;
``test/rostest/documents`` runs it on a live team. What cannot be run here is in :data:`NOT_RUN`,
with the reason. A command that is none of these fails.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import urllib.request
import xml.etree.ElementTree as ElementTree
from functools import lru_cache
from pathlib import Path
from typing import List, Tuple

import pytest
from document_commands import PACKAGE, ROOT, Command, File, documents, steps
from PIL import Image
from terminal import Terminal
from test_project_files import apt_packages
from waiting import PATIENCE

import gspn_framework_package
from gspn_framework_package.cli.main import _parser, all_verbs, main
from gspn_framework_package.team.order_fields import FieldKind
from gspn_framework_package.team.orders import ORDERS

NOT_RUN = (
    (r"source /opt/ros/noetic/setup\.bash", "another distribution"),
    (r"rosdep install --from-paths src --ignore-src -y", "the network; another distribution"),
    (r"catkin_make", "another distribution: Debian needs an option, and is typed below"),
    (r"sudo apt-get install .+", "changes the machine; what it installs is compared below"),
    (r"pip3? install .+", "the network; what it installs is compared below"),
    (r"python3 -m venv ~/gspn", "for the next: scripts/check_install.sh does the same offline"),
    (r"~/gspn/bin/(pip install \.|gspn --help)", "the network"),
    (r"rostest --pkgdir .+", "a ROS master: test/rostest/new runs such a one"),
    (r"python3 -m coverage report -m", "a library that the tests do without"),
    (r"rosrun fkie_master_(discovery|sync) \w+", "a package of others"),
    (r"(storm|prism) .+", "programs of others; test/unit/formats reads the files with stormpy"),
)
"""Commands that are not run, and what they need that is not here."""

ENDLESS = {"serve", "replay", "record", "router", "agent"}
"""Verbs that end at Ctrl-C, or follow a live team: their arguments are parsed, the rest is tested
elsewhere."""

LONG = {"film"}
"""Verbs that take minutes: their arguments are parsed, the rest is tested elsewhere."""

SERVICES = {
    "get_place": "GetPlace",
    "get_state": "GetState",
    "set_place": "SetPlace",
    "command": "Command",
    "order_fault": "Command",
}
TOPICS = {
    "fault",
    "fired_transitions",
    "gspn_agreement",
    "activity",
    "diagnostics",
    "clock",
    "rosout",
}

SECONDS = 1.0
"""What ``--seconds`` is cut to, and what a computed policy is simulated for (else 5 s)."""

PRECISION = 0.5
"""What ``--precision`` is widened to: fewer runs reach it."""

PREDICTED = 20
"""How many runs are simulated where the document says 100 or more, or, of a comparison, nothing (as many as it needs)."""

QUOTED = re.compile(r"'[^']*'")
FOR_A_SHELL = re.compile(r"[|&;<>()$`*?~{\\]")
"""What only a shell understands, outside single quotes."""

DOCUMENTS = documents()

TYPED = ("docs/five_minutes.md",)
"""Documents whose ``python3 -m gspn_framework_package`` commands are typed in a terminal below, each
once and with the same demands: what runs them all need not run those."""


ANYWHERE = "docs/teams_anywhere.md"
"""Typed below too, in a terminal for each program that goes on."""

FIRST_PLAN, INSTALLING = "docs/first_plan.md", "docs/installing.md"

README_RUN = "gspn run charge --allow-commands --firings 7"
"""Run below, where its output is compared too."""


def _name(document: Path) -> str:
    return str(document.relative_to(ROOT))


@pytest.fixture
def sandbox(tmp_path):
    """A folder that looks like a checkout, whose files a command may write over."""
    for name in os.listdir(ROOT):
        if name == "plans":
            shutil.copytree(
                ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__")
            )
        elif not name.startswith(".") and name not in ("docs", "build"):
            (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


@pytest.mark.parametrize("document", DOCUMENTS, ids=_name)
def test_commands(document, sandbox, monkeypatch, capfd):
    monkeypatch.chdir(sandbox)
    for step in steps(document):
        if isinstance(step, File):
            path = sandbox / step.path
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(step.text, encoding="utf-8")
            if path.suffix == ".py":
                compile(step.text, str(path), "exec")
        else:
            _try(step, sandbox, capfd)


def _try(command: Command, sandbox: Path, capfd: pytest.CaptureFixture) -> None:
    if any(re.fullmatch(pattern, command.line) for pattern, _ in NOT_RUN):
        return
    if command.document == FIRST_PLAN and not command.line.startswith("ros"):
        return  # typed below
    if command.line == README_RUN or command.line in {step.line for step in workspace_on_debian()}:
        return  # typed below
    words = Command(*command[:2], re.sub(r"\$\([^)]*\)", "FOUND", command.line), "").words
    if command.document == ANYWHERE and words[0] in ("gspn", "python3"):
        return
    if command.document in TYPED and words[:3] == ["python3", "-m", PACKAGE]:
        return
    if words[0] == "gspn":
        words = ["python3", "-m", PACKAGE] + words[1:]
    if words[:3] == ["python3", "-m", PACKAGE]:
        _try_gspn(command, words[3:], sandbox, capfd)
    elif words[:3] == ["python3", "-m", "pytest"] and len(words) == 4:
        _passes(command, [sys.executable, *words[1:], "-p", "no:cacheprovider"], sandbox)
    elif words[:4] == ["python3", "-m", "coverage", "run"]:
        at = words.index("-m", 4)
        _options_exist(command, [sys.executable, *words[at : at + 2]], words[at + 2 :])
    elif words[:2] == ["python3", "-m"] and words[2].split(".")[0] == "benchmarks":
        _options_exist(command, [sys.executable] + words[1:3], words[3:])
    elif words[0] in ("./run_demo", "./run_tests"):
        _options_exist(command, [str(ROOT / words[0])], words[1:])
    elif words[0] in ("docs/build", "scripts/check_spec", "scripts/make_deb"):
        assert os.access(ROOT / words[0], os.X_OK), str(command)
    elif words[0] == "export":
        _passes(command, ["bash", "-c", command.line], sandbox)
    elif words[0] in ROS_COMMANDS:
        ROS_COMMANDS[words[0]](command, words[1:])
    else:
        pytest.fail("%s\nis a command that no test knows how to try" % str(command))


# -- without ROS -----------------------------------------------------------------------------------


def _passes(command: Command, words: list, sandbox: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    tried = subprocess.run(
        words,
        cwd=str(sandbox),
        env=environment,
        capture_output=True,
        text=True,
        timeout=300 * PATIENCE,
    )
    assert tried.returncode == 0, "%s\n%s%s" % (command, tried.stdout, tried.stderr)


def _try_gspn(command: Command, words: list, sandbox: Path, capfd: pytest.CaptureFixture) -> None:
    verb = next((word for word in words if not word.startswith("-")), None)
    if verb in ENDLESS | LONG:
        _parses(command, words)
        return
    line = _shorter(command)
    line = re.sub(r"^(gspn|python3 -m %s)(?= |$)" % PACKAGE, "", line)
    if FOR_A_SHELL.search(QUOTED.sub("", line)):
        code, told = _in_a_shell(line, sandbox)
    else:  # the program's start, which the terminals below have too, would take most of the time
        code = main(shlex.split(line))
        told = "".join(capfd.readouterr())
    assert code == command.exit_code, "%s\n%s" % (command, told)
    assert "Traceback" not in told, "%s\n%s" % (command, told)


def _shorter(command: Command) -> str:
    line = re.sub(r"(?<=--seconds[= ])[0-9.]+", "%g" % SECONDS, command.line)
    line = re.sub(r"(?<= --precision )[0-9.]+", "%g" % PRECISION, line)
    line = re.sub(r"(?<= --replications )[0-9]{3,}", str(PREDICTED), line)
    line = re.sub(
        r" compare (?!.*--rep(?:lay|lications))", r"\g<0>--replications %d " % PREDICTED, line
    )
    return re.sub(r" optimise (?!.*--simulate )", r"\g<0>--simulate %g " % SECONDS, line)


def _in_a_shell(line: str, sandbox: Path) -> Tuple[int, str]:
    environment = dict(
        os.environ, PYTHON=sys.executable, PYTHONPATH=str(ROOT), PYTHONDONTWRITEBYTECODE="1"
    )
    ended = subprocess.run(
        ["bash", "-c", '"$PYTHON" -m ' + PACKAGE + line],
        cwd=str(sandbox),
        env=environment,
        timeout=120 * PATIENCE,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    return ended.returncode, ended.stdout


def _parses(command: Command, words: list) -> None:
    """The words are a command line of the program."""
    try:
        _parser(words).parse_args(words)
    except SystemExit as leaving:
        assert leaving.code == 0, str(command)


def _options_exist(command: Command, program: list, words: list) -> None:
    """The program's help speaks of every option."""
    code, told = _help(tuple(program))
    assert code == 0, "%s\n%s" % (command, told)
    for word in words:
        option = word.split("=")[0]
        if option.startswith("-"):
            assert re.search(r"(?<![\w-])%s(?![\w-])" % re.escape(option), told), str(command)


@lru_cache(maxsize=None)
def _help(program: Tuple[str, ...]) -> Tuple[int, str]:
    """The exit code and the help of a program, which several commands call."""
    told = subprocess.run(
        [*program, "--help"],
        cwd=str(ROOT),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=120 * PATIENCE,
        text=True,
    )
    return told.returncode, told.stdout


# -- typed in a terminal ---------------------------------------------------------------------------


def _terminal(folder: Path, home: Path) -> Terminal:
    """A shell whose ``python3`` has the libraries, and knows nothing of this checkout."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["PATH"] = os.path.dirname(sys.executable) + os.pathsep + environment["PATH"]
    return Terminal(folder, {**environment, "HOME": str(home), "PYTHONDONTWRITEBYTECODE": "1"})


def test_the_first_plan_typed_in_a_terminal(tmp_path):
    """From the first line to the last that needs no ROS: each command ends well, and the check says
    what is promised. It begins in the checkout; the document says how to go on from there."""
    said = []
    with _terminal(ROOT, home=tmp_path) as terminal:
        for step in steps(ROOT / "docs/first_plan.md"):
            if isinstance(step, File):
                path = tmp_path / step.path
                assert path.parent.is_dir(), "the document has not made %s" % path.parent
                path.write_text(step.text, encoding="utf-8")
            elif not step.line.startswith("ros"):
                code, text = terminal.type(step.line)
                assert code == step.exit_code, "%s\n%s" % (step, text)
                assert "Traceback" not in text, text
                said.append((step.words[3:4], text))
    checks = [text for verb, text in said if verb == ["check"]]
    assert len(checks) == 3  # two of part one, one of part two
    assert [text.split()[-3] for verb, text in said if verb == ["verify"]] == ["valid"]
    assert (
        "the policy has no row, so that the weights decide for a robot in Look in (Look: 2, Tap: 1"
        in checks[0]
    )
    assert "no row" not in checks[1]
    assert not any("warning" in text for text in checks[1:])
    assert not any("not decided" in text or "without bound" in text for text in checks)


def test_five_minutes_typed_in_a_terminal(sandbox, tmp_path):
    """All that needs no ROS, in a checkout: each command ends as it says, the page
    at Ctrl-C."""
    typed = []
    with _terminal(sandbox, home=tmp_path) as terminal:
        for step in steps(ROOT / "docs/five_minutes.md"):
            if not isinstance(step, Command) or step.words[:3] != ["python3", "-m", PACKAGE]:
                continue
            typed.append(step.words[3])
            line = _shorter(step)
            if typed[-1] in ENDLESS:
                terminal.begin(line + " --port 0")
                address = re.search(r"http://[^\s]+", terminal.shows(r"The page is at .*Ctrl-C"))
                assert address, str(step)
                with urllib.request.urlopen(address.group(0), timeout=60 * PATIENCE) as page:
                    assert b"<title" in page.read(), str(step)
                terminal.interrupt()
                code, text = terminal.end()
                assert code in (0, 130), "%s\n%s" % (step, text)
            else:
                code, text = terminal.type(line)
                assert code == step.exit_code, "%s\n%s" % (step, text)
            assert "Traceback" not in text, "%s\n%s" % (step, text)
    assert typed == (
        [
            *("new", "check", "check", "run", "analyse", "simulate", "fit", "compare", "optimise"),
            *("new", "serve", "serve", "replay"),
        ]
    )


def workspace_on_debian() -> List[Command]:
    """The lines of docs/installing.md that build a workspace on Debian 12."""
    found = [step for step in steps(ROOT / INSTALLING) if isinstance(step, Command)]
    lines = [step.line for step in found]
    begin = lines.index("mkdir -p ~/catkin_ws/src")
    return found[begin : lines.index("source devel/setup.bash") + 1]


@pytest.mark.skipif(not os.path.exists("/usr/bin/catkin_make"), reason="not the ROS of Debian")
def test_the_workspace_on_debian_typed_in_a_terminal(tmp_path):
    typed = workspace_on_debian()
    assert len(typed) == 5
    environment = {"HOME": str(tmp_path), "PATH": "/usr/sbin:/usr/bin:/sbin:/bin"}
    # scripts/make_deb builds the messages in all languages
    environment["ROS_LANG_DISABLE"] = "gencpp:geneus:genlisp:gennodejs"
    with Terminal(ROOT, {**environment, "LC_ALL": "C.UTF-8"}) as terminal:
        for step in typed:
            code, text = terminal.type(step.line, patience=280)
            assert code == 0, "%s\n%s" % (step, text[-3000:])
        # run_demo and run_tests have built copies of all of this in the checkout, which ROS must not find;
        # the build's own tests read each launch file
        line = "roslaunch --files gspn_framework_package team.launch plan:=none"
        code, text = terminal.type(line)
        assert (code, "/team.launch" in text) == (0, True), text
        code, text = terminal.type("rosrun gspn_framework_package gspn --version")
        assert (code, "gspn " + gspn_framework_package.__version__ in text) == (0, True), text


def test_what_the_documents_install_is_what_the_tests_run_with():
    """A shell expands the list for apt; pip gets libraries that scripts/requirements.txt has."""
    names = {apt for path in DOCUMENTS for apt in _lines(path, "sudo apt-get install $(")}
    for line in names:
        found = subprocess.check_output(
            ["bash", "-c", "echo " + line.split("install ", 1)[1]], cwd=str(ROOT), text=True
        )
        assert set(found.split()) == apt_packages(0)
    assert len(names) == 1
    known = (ROOT / "scripts/requirements.txt").read_text(encoding="utf-8")
    piped = [line for path in DOCUMENTS for line in _lines(path, "pip install ", "pip3 install ")]
    libraries = {
        re.match(r"[\w-]+", w).group() for s in piped for w in shlex.split(s)[2:] if w[0] != "-"
    }
    assert "duckdb" in libraries
    for library in libraries - {"coverage"}:
        assert re.search("^%s[><=]" % library, known, re.MULTILINE), library


def _lines(document: Path, *starts: str) -> List[str]:
    found = [step.line for step in steps(document) if isinstance(step, Command)]
    return [line for line in found if line.startswith(starts)]


def test_teams_anywhere_typed_in_terminals(sandbox, tmp_path):
    """Every line that needs no ROS: routers and robots continue in terminals of their own, and end
    as they should."""
    pytest.importorskip("zenoh")
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = str(found.getsockname()[1])
    (tmp_path / "bin").mkdir()
    gspn = tmp_path / "bin" / "gspn"
    gspn.write_text('#!/bin/sh\nexec "%s" -m %s "$@"\n' % (sys.executable, PACKAGE))
    gspn.chmod(0o755)
    environment = {
        **os.environ,
        "HOME": str(tmp_path),
        "PATH": "%s:%s" % (gspn.parent, os.environ["PATH"]),
        "PYTHONPATH": str(ROOT),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    environment.pop("ROS_HOME", None)
    typed, robots = [], []
    with contextlib.ExitStack() as stack:

        def terminal():
            return stack.enter_context(Terminal(sandbox, environment))

        here = terminal()
        for step in steps(ROOT / ANYWHERE):
            assert isinstance(step, Command), str(step)
            words, line = step.words, step.line.replace("7447", port)
            if words[0] != "gspn":
                continue
            typed.append(words[1])
            if words[1] not in ENDLESS or "--print-config" in words:
                if words[1] == "status":
                    here.type("until %s > told; do sleep 0.2; done" % line)
                code, text = here.type(line)
                assert code == step.exit_code, "%s\n%s" % (step, text)
                assert "Traceback" not in text, text
            elif words[1] == "agent":
                robots.append(terminal())
                robots[-1].begin(line)
            elif words[1] == "serve":
                page = terminal()
                page.begin(line + " --port 0")
                page.shows(r"The page is at http://[^\s]+")
                page.interrupt()
                code, text = page.end()
                assert code in (0, 130), text
            else:
                router = terminal()
                router.begin(line)
                router.shows("listening at")
            if words[1] == "stop":
                for robot in robots:
                    code, text = robot.end()
                    assert code == 1 and "the run is over: " in text, text
        router.interrupt()
        assert router.end()[0] in (0, 130)
    assert typed == [
        *("keys", "router", "agent", "agent", "agent", "status", "pause", "resume", "pause"),
        *("serve", "stop", "verify", "router"),
    ]


# -- with ROS --------------------------------------------------------------------------------------


def _try_roslaunch(command: Command, words: list) -> None:
    words = [word for word in words if not word.startswith("--")]
    assert words[0] == PACKAGE, str(command)
    path = ROOT / "launch" / words[1]
    assert path.is_file(), str(command)
    known = {arg.get("name"): arg for arg in ElementTree.parse(str(path)).getroot().findall("arg")}
    given = dict(word.split(":=", 1) for word in words[2:])
    for name in given:
        assert name in known, "%s: %s has no argument '%s'" % (command, path.name, name)
    if "--ros-args" in command.line:
        return
    for name, arg in known.items():
        assert name in given or "default" in arg.attrib or "value" in arg.attrib, (
            "%s: needs %s:=" % (command, name)
        )


def _try_rosrun(command: Command, words: list) -> None:
    assert words[0] == PACKAGE, str(command)
    assert os.access(ROOT / "scripts" / words[1], os.X_OK), str(command)
    if words[1] == "gspn":
        _parses(command, words[2:])


def _try_rosservice(command: Command, words: list) -> None:
    assert words[0] == "call", str(command)
    name = words[1].rsplit("/", 1)[-1]
    assert name in SERVICES, str(command)
    request = (ROOT / "srv" / (SERVICES[name] + ".srv")).read_text(encoding="utf-8").split("---")[0]
    fields = re.findall(r"^\w+(?:\[\])? (\w+)", request, re.MULTILINE)
    assert len(words) > 2, (
        "%s: in a terminal rosservice asks for arguments, for {} where there are none" % command
    )
    if len(words) > 2:
        import yaml

        given = yaml.safe_load(words[2])
        assert set(given) <= set(fields), str(command)
        if name == "command":
            source = (ROOT / "srv/Command.srv").read_text(encoding="utf-8")
            orders = re.search(r"^string command((.|\n)*?)^string", source, re.M).group(1)
            assert given["command"] in re.findall(r"\w+", orders), str(command)


def _try_rostopic(command: Command, words: list) -> None:
    assert words[0] in ("echo", "hz", "info", "list", "bw", "pub"), str(command)
    if words[0] == "pub":
        import yaml

        assert json.loads(yaml.safe_load(words[-1])["data"]), str(command)
    topics = [word for word in words[1:] if word.startswith("/")]
    assert topics or words[0] == "list", str(command)
    for topic in topics:
        assert topic.rsplit("/", 1)[-1] in TOPICS, str(command)


def _try_rosnode(command: Command, words: list) -> None:
    assert words[0] in ("kill", "list", "info", "ping"), str(command)


ROS_COMMANDS = {
    "roslaunch": _try_roslaunch,
    "rosrun": _try_rosrun,
    "rosservice": _try_rosservice,
    "rostopic": _try_rostopic,
    "rosnode": _try_rosnode,
}


# -- the reference agrees with the code ------------------------------------------------------------


def _text(name: str) -> str:
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def test_every_verb_is_documented():
    tables = re.findall(r"^\| verb \|.*?\n\n", _text("commands.md"), re.MULTILINE | re.DOTALL)
    rows = re.findall(r"^\| (`[^|]*)\|", "".join(tables), re.MULTILINE)
    table = {verb for row in rows for verb in re.findall(r"`([\w-]+)", row)}
    assert table == set(all_verbs())


def test_every_order_is_documented_where_it_is_called():
    section = re.search(r"^### Commands\n(.*?)^### ", _text("ros_interface.md"), re.M | re.S).group(
        1
    )
    rows = re.findall(r"^\| (`[^|]*)\|([^|]*)\|([^|]*)\|", section, re.MULTILINE)
    documented = {
        name: (robot.strip(), argument.strip())
        for names, robot, argument in rows
        for name in re.findall(r"`(\w+)`", names)
    }
    service = (ROOT / "srv/Command.srv").read_text(encoding="utf-8")
    listed = re.search(r"^string command((.|\n)*?); sealed", service, re.M).group(1)
    assert set(documented) - {"sealed"} == set(ORDERS) == set(re.findall(r"\w+", listed))
    for name, kind in ORDERS.items():
        robot, argument = documented[name]
        kinds = [field.kind for field in kind.fields]
        assert bool(robot) == (FieldKind.ROBOT in kinds), name
        assert bool(argument) == bool(set(kinds) - {FieldKind.ROBOT}), name


def test_every_key_of_a_plan_is_documented():
    schema = json.loads((ROOT / PACKAGE / "formats/plan.schema.json").read_text(encoding="utf-8"))
    text = _text("plan_file.md")
    for key in schema["properties"]:
        assert re.search(r"^\| `%s`" % re.escape(key), text, re.MULTILINE), key
    for key in schema["properties"]["agreement"]["properties"]:
        assert "`%s`" % key in text, key


def test_every_launch_file_and_argument_is_documented():
    text = _text("ros_interface.md")
    for path in sorted((ROOT / "launch").glob("*.launch")):
        assert "`%s`" % path.name in text, path.name
    for arg in ElementTree.parse(str(ROOT / "launch/robot.launch")).getroot().findall("arg"):
        assert re.search(r"^\| `%s` \|" % arg.get("name"), text, re.MULTILINE), arg.get("name")


def test_every_parameter_is_documented():
    source = (ROOT / PACKAGE / "ros/options.py").read_text(encoding="utf-8")
    fields = re.search(
        r"class NodeOptions\(NamedTuple\):(.*?)\n    @property", source, re.DOTALL
    ).group(1)
    names = re.findall(r"^    (\w+): ", fields, re.MULTILINE)
    assert "plan" in names
    text = _text("ros_interface.md")
    for name in names:
        assert re.search(r"^\| `~%s` \|" % name, text, re.MULTILINE), name


def test_the_example_of_the_thesis_form_is_read(tmp_path):
    from gspn_framework_package.formats.plan_file import read_plan
    from gspn_framework_package.formats.registry import write_net
    from gspn_framework_package.model.builder import NetBuilder

    written = [
        s
        for s in steps(ROOT / "docs/plan_file.md")
        if isinstance(s, File) and s.path.startswith("thesis_input")
    ]
    path = tmp_path / "input.json"
    path.write_text(written[0].text, encoding="utf-8")
    net = NetBuilder().place("A", tokens=2).place("B")
    net.immediate("go", inputs="A", outputs="B").immediate("stay", inputs="A", outputs="A")
    write_net(net.immediate("back", inputs="B", outputs="A").build(), tmp_path / "net.xml")
    plan = read_plan(str(path))
    assert [(r.name, r.place) for r in plan.robots] == [("1", "A"), ("2", "A")]
    assert plan.policy.rows[0].counts == (None, 1)
    assert any("does not exist" in note for note in plan.notes)


def test_the_gallery_shows_every_plan_as_it_is():
    from gspn_framework_package.formats.plan_file import read_plan

    text = _text("gallery.md")
    plans = sorted(path.parent for path in (ROOT / "plans").glob("*/plan.json"))
    assert sorted(re.findall(r"^## (\w+):", text, re.MULTILINE)) == [plan.name for plan in plans]
    for plan in plans:
        assert "](../plans/%s/net.svg)" % plan.name in text
        picture = ElementTree.parse(str(plan / "net.svg"))
        shown = {element.text for element in picture.iter("{http://www.w3.org/2000/svg}text")}
        net = read_plan(str(plan)).net
        names = {place.name for place in net.places} | {t.name for t in net.transitions}
        if plan.name == "inspection":  # its picture has one level of the battery
            assert len(shown & names) > 10
        else:
            assert names <= shown, "gspn draw {0} -o {0}/net.svg".format("plans/" + plan.name)


def test_the_site_and_its_first_page_list_every_document():
    text = _text("index.md")
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"}
    assert pages <= set(re.findall(r"^([a-z_0-9]+)$", text, re.MULTILINE))
    parts = {page for page in pages if page.startswith("benchmarks_")}  # benchmarks.md leads there
    assert pages - parts <= set(re.findall(r"\]\((\w+)\.md", text))


def test_the_readme_shows_a_plan_then_a_film():
    """Two screens of text: what it is and how it starts, a plan and its run; then why."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = readme.splitlines()
    assert len(lines) <= 95
    assert [line.split()[0] for line in lines[7:9]] == ["./run_demo", "./run_tests"]
    plan, output = readme.index("```json charge/plan.json"), readme.index("```text")
    assert readme[:plan].count("\n") < 25 and plan < output < readme.index("| **this package** |")
    prose = re.sub(r"```.*?```|^\|.*$", "", readme, flags=re.DOTALL | re.MULTILINE)
    assert max(len(part.splitlines()) for part in prose.split("\n\n")) <= 4
    assert "](docs/index.md)" in readme and "](docs/recipes.md)" in readme
    (film,) = re.findall(r"!\[[^]]*\]\((docs/images/\S+\.webp)\)", readme)
    assert os.path.getsize(ROOT / film) < 3_000_000
    with Image.open(ROOT / film) as pictures:
        assert pictures.n_frames > 50


def test_the_plan_of_the_readme_prints_what_the_readme_says(tmp_path):
    found = list(steps(ROOT / "README.md"))
    (plan,) = [step for step in found if isinstance(step, File)]
    assert README_RUN in [step.line for step in found if isinstance(step, Command)]
    path = tmp_path / plan.path
    path.parent.mkdir()
    path.write_text(plan.text, encoding="utf-8")
    ran = subprocess.run(
        [sys.executable, "-m", PACKAGE, *README_RUN.split()[1:]],
        cwd=str(tmp_path),
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120 * PATIENCE,
    )
    assert ran.returncode == 0, ran.stderr
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```text\n(.*?)```", readme, re.DOTALL)
    seconds = re.compile(r"in [0-9.]+ s;")
    assert seconds.sub("", ran.stdout) == seconds.sub("", shown)
    picture = (ROOT / "docs/images/charge.svg").read_text(encoding="utf-8")
    nodes = json.loads(plan.text)["net"]
    assert all(">%s<" % node["name"] in picture for node in nodes["places"] + nodes["transitions"])


def test_each_of_the_thirty_recipes_is_one_command():
    recipes = _text("recipes.md").split("\n### ... ")[1:]
    assert len(recipes) == 30
    for recipe in recipes:
        assert recipe.split("\n")[0].endswith("?"), recipe
        assert len(re.findall(r"```sh\n[^\n]+\n```", recipe)) == recipe.count("```sh") == 1, recipe


def test_the_program_that_films_the_readme_starts():
    code, told = _help((sys.executable, "test/browser/film_demo.py"))
    assert code == 0 and "FILM" in told, told


@pytest.mark.parametrize("document", DOCUMENTS, ids=_name)
def test_links(document):
    text = re.sub(r"```.*?```", "", document.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        path = target.split("#")[0]
        if path and "://" not in target:
            assert (document.parent / path).exists(), target


def test_the_test_of_each_attack_exists():
    table = (ROOT / "docs/security.md").read_text().split("| attack |")[1].split("\n\n")[0]
    attacks = [re.findall(r"`(test_\w+)\.(test_\w+)`", row) for row in table.split("\n")[2:]]
    assert len(attacks) >= 10
    assert all(attacks), "an attack has no test"
    files = {path.stem: path.read_text() for path in ROOT.glob("test/**/test_*.py")}
    named = {found for row in attacks for found in row}
    assert {(f, t) for f, t in named if "def %s(" % t not in files.get(f, "")} == set()
