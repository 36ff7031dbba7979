"""What helps at the prompt: completion, the manual page, and what was probably meant."""

import shutil
import subprocess

import pytest

from gspn_framework_package.cli.main import main, parsers

ALL = parsers()


def printed(words, capsys):
    assert main(words) == 0
    return capsys.readouterr().out


@pytest.fixture(scope="module", name="script")
def _script(tmp_path_factory):
    from gspn_framework_package.cli.completion import completion_script

    path = tmp_path_factory.mktemp("completion") / "gspn"
    path.write_text(completion_script(ALL))
    return path


def offered(script, line):
    """What bash offers at the end of a line; in square brackets: nothing of its own, so files."""
    words = line.split(" ")
    code = '. "$0"; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _gspn; echo "${COMPREPLY[@]}"'
    ran = subprocess.run(
        ["bash", "-c", code, str(script), *words], stdout=subprocess.PIPE, text=True, check=True
    )
    return ran.stdout.split()


@pytest.mark.parametrize(
    "line, words",
    [
        ("gspn op", ["optimise"]),
        ("gspn --v", ["--version"]),
        ("gspn simulate --rep", ["--replications"]),
        ("gspn analyse net.xml --engine num", ["numpy", "numba"]),
        ("gspn plot --what tok", ["tokens"]),
        ("gspn completion z", ["zsh"]),
        ("gspn check ", []),
        ("gspn check --robots ", []),
        ("gspn no-such-verb --", []),
    ],
)
def test_bash_offers(script, line, words):
    assert offered(script, line) == words


def test_bash_offers_every_verb_and_every_option(script):
    assert set(ALL) <= set(offered(script, "gspn "))
    for verb in ("simulate", "optimise", "submit"):
        names = {name for action in ALL[verb]._actions for name in action.option_strings}
        assert set(offered(script, "gspn %s -" % verb)) == names


def test_zsh_loads_the_same_script(capsys):
    bash, zsh = printed(["completion", "bash"], capsys), printed(["completion", "zsh"], capsys)
    assert zsh.endswith(bash)
    assert "bashcompinit" in zsh[: -len(bash)]


def test_the_manual_page_has_every_verb_and_option(capsys):
    page = printed(["man"], capsys)
    for verb, parser in ALL.items():
        part = page.split(".SS %s\n" % verb.replace("-", "\\-"), 1)[1].split("\n.SS ", 1)[0]
        for action in parser._actions:
            for name in set(action.option_strings) - {"-h", "--help"}:
                assert name.replace("-", "\\-") in part, (verb, name)
    if shutil.which("groff"):
        warned = subprocess.run(
            ["groff", "-man", "-Tascii", "-ww", "-z"],
            input=page.encode("ascii", "replace"),
            stderr=subprocess.PIPE,
            check=True,
        )
        assert warned.stderr == b""


@pytest.mark.parametrize(
    "words, said",
    [
        (["analyse", "net.xml", "--robts=3"], "(did you mean --robots?)"),
        (["simulate", "net.xml", "--replicatons", "3"], "(did you mean --replications?)"),
        (["check", "plan", "--nothing-like-it"], "unrecognized arguments: --nothing-like-it\n"),
    ],
)
def test_a_misspelt_option_is_answered_with_the_one_that_was_meant(words, said, capsys):
    assert main(words) == 2
    assert said in capsys.readouterr().err
