"""run_demo and run_tests: usage, and how results are counted. What they start is tested by use."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE

ROOT = Path(__file__).resolve().parents[2]


def run(*words, **options):
    return subprocess.run(
        [str(word) for word in words],
        cwd=str(ROOT),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60 * PATIENCE,
        **options,
    )


# --- usage


@pytest.mark.parametrize("command", ["run_demo", "run_tests"])
def test_help(command):
    shown = run(ROOT / command, "--help")
    assert shown.returncode == 0
    assert shown.stdout.startswith("Usage: ./{} ".format(command))
    assert shown.stderr == ""


@pytest.mark.parametrize(
    "words, message",
    [
        (["run_tests", "--no-such"], "run_tests: error: unknown option: --no-such"),
        (["run_tests", "-k"], "run_tests: error: -k needs a value"),
        (["run_demo", "--no-such"], "run_demo: error: unknown option: --no-such"),
        (["run_demo", "--robots"], "run_demo: error: --robots needs a value"),
        (["run_demo", "--robots", "0"], "run_demo: error: --robots: not a number of robots: 0"),
        (["run_demo", "--robots=x"], "run_demo: error: --robots: not a number of robots: x"),
        (["run_demo", "--seconds=-1"], "run_demo: error: --seconds: not a number of seconds: -1"),
        (["run_demo", "--plan", "no/such"], "run_demo: error: --plan: no such folder: no/such"),
    ],
)
def test_wrong_usage_exits_with_2_and_says_why(words, message):
    shown = run(ROOT / words[0], *words[1:])
    assert shown.returncode == 2
    assert shown.stdout == ""
    assert shown.stderr.startswith(message)
    assert len(shown.stderr.splitlines()) == 1


# --- the set-up


@pytest.fixture
def prepared(tmp_path):
    """Returns a function that runs lines of bash in a script that has sourced the set-up."""

    def run_lines(lines, **options):
        script = tmp_path / "run_check"
        script.write_text("#!/bin/bash\n. '{}'\n{}".format(ROOT / "scripts/prepare.sh", lines))
        script.chmod(0o755)
        return run(script, **options)

    return run_lines


def test_each_system_lists_its_own_packages(prepared):
    debian = prepared("is_noetic() { false; }; system_packages").stdout.split()
    noetic = prepared("is_noetic() { true; }; system_packages").stdout.split()
    assert {"python3-rospy", "python3-lxml", "python3-rostest"} <= set(debian)
    assert {"ros-noetic-rospy", "python3-lxml", "ros-noetic-rostest"} <= set(noetic)
    assert not [name for name in debian if name == "-" or "noetic" in name]
    assert not [name for name in noetic if name == "-" or name.startswith(("ros-core", "librost"))]


@pytest.mark.long
@pytest.mark.parametrize("ignored", ["HUP", "HUP INT", "HUP INT TERM"])
def test_the_end_reaches_what_has_moved_to_a_session_of_its_own(prepared, ignored):
    shown = prepared(
        """
        GRACE=1
        (trap "" {}; exec setsid sleep 60 >/dev/null) & disown
        until [ -n "$(session_processes)" ]; do :; done
        session_processes
        end_session
        echo left: $(session_processes)
        """.format(ignored)
    )
    process, left = shown.stdout.split(maxsplit=1)
    assert int(process) > 0
    assert left == "left:\n"


def test_the_end_looks_again_for_a_process_that_is_just_starting_a_program(prepared, tmp_path):
    """Its environment, and with it the mark, is not there for a moment."""
    shown = prepared(
        """
        GRACE=1
        setsid sleep 60 >/dev/null 2>&1 & disown
        until [ -n "$(session_processes)" ]; do :; done
        eval "really_$(declare -f session_processes)"
        session_processes() {{ mkdir '{}' 2>/dev/null || really_session_processes; }}
        end_session
        echo left: $(really_session_processes)
        """.format(tmp_path / "looked")
    )
    assert shown.stdout == "left:\n"


def test_the_end_spares_what_this_run_has_not_started(prepared):
    with subprocess.Popen(["sleep", "60"]) as other:
        assert prepared("end_session; echo ended").stdout == "ended\n"
        assert other.poll() is None
        other.kill()


@pytest.mark.parametrize("handler", [signal.SIG_IGN, signal.SIG_DFL])
def test_sigint_is_heard_even_where_it_was_ignored(prepared, handler):
    shown = prepared(
        'trap "echo heard; exit 7" INT; kill -INT $$; echo not heard',
        preexec_fn=lambda: signal.signal(signal.SIGINT, handler),
    )
    assert shown.stdout.split() == ["heard"]
    assert shown.returncode == 7


# --- results


def count(folder):
    shown = run(sys.executable, ROOT / "scripts/count_results.py", folder)
    assert shown.returncode == 0
    return [int(word) for word in shown.stdout.split()], shown.stderr.splitlines()


def test_results_are_added_up(tmp_path):
    (tmp_path / "a.xml").write_text(
        '<testsuites><testsuite tests="4" failures="1" errors="1" skipped="1">'
        '<testcase classname="m" name="a"/><testcase classname="m" name="b"><failure/></testcase>'
        '<testcase classname="m" name="c"><error/></testcase>'
        '<testcase classname="m" name="d"><skipped/></testcase></testsuite></testsuites>'
    )
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "b.xml").write_text(
        '<testsuite tests="1" failures="0"><testcase classname="n" name="e"/></testsuite>'
    )
    assert count(tmp_path) == ([2, 2, 1], ["failed: m.b", "failed: m.c"])


@pytest.mark.parametrize("text", ["", "<testsuite tests='3'><testcase"])
def test_a_result_file_that_is_cut_is_a_failure(tmp_path, text):
    (tmp_path / "a.xml").write_text(text)
    totals, names = count(tmp_path)
    assert totals == [0, 1, 0]
    assert names[0].startswith("failed: a.xml: no readable result")


def test_an_error_that_belongs_to_no_case_is_a_failure(tmp_path):
    # as rostest reports a node that died or a test that ran out of time
    (tmp_path / "a.xml").write_text(
        '<testsuite tests="1" errors="1"><testcase classname="n" name="e"/></testsuite>'
    )
    totals, names = count(tmp_path)
    assert totals == [0, 1, 0]
    assert names == ["failed: a.xml: 1 more"]


def test_no_result_file_is_no_test(tmp_path):
    assert count(tmp_path) == ([0, 0, 0], [])
