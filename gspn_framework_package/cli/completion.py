"""``gspn completion``: prints a script that lets a shell complete the words of a command line."""

from __future__ import annotations

import argparse
import shlex
from typing import Dict, Iterator, List

from gspn_framework_package.cli.options import Arguments, choice

SHELLS = ("bash", "zsh")

OPTIONS: Arguments = {
    choice("shell", SHELLS): (
        "the shell; 'eval \"$(gspn completion bash)\"' in ~/.bashrc, or zsh in ~/.zshrc, loads it"
    ),
}

_ZSH = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"

_SCRIPT = """\
_gspn() {
    local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]} verb=${COMP_WORDS[1]}
    local words= options=
    if [ "$COMP_CWORD" -eq 1 ]; then
        words=%(verbs)s
    else
        case "$verb $before" in
%(values)s
            *)
                case "$verb" in
%(options)s
                esac
                if [[ $word == -* ]]; then words=$options; fi ;;
        esac
    fi
    COMPREPLY=($(compgen -W "$words" -- "$word"))
}
complete -o bashdefault -o default -F _gspn gspn
"""


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from gspn_framework_package.cli.main import parsers

    print((_ZSH if args.shell == "zsh" else "") + completion_script(parsers()), end="")
    return 0


def completion_script(parsers: Dict[str, argparse.ArgumentParser]) -> str:
    """The script for bash. Where it offers nothing, the shell offers files.

    :param parsers: verb -> its parser.
    """
    values: List[str] = []
    options: List[str] = []
    for verb, parser in parsers.items():
        words: List[str] = []
        names: List[str] = []
        for action in parser._actions:
            names += action.option_strings
            offered = list(map(str, action.choices or ()))
            if action.option_strings and offered:
                cases = "|".join(shlex.quote("%s %s" % (verb, o)) for o in action.option_strings)
                values.append("%s) words=%s ;;" % (cases, _quoted(offered)))
            elif offered:
                words += offered
        options.append("%s) words=%s options=%s ;;" % (verb, _quoted(words), _quoted(names)))
    return _SCRIPT % {
        "verbs": _quoted([*parsers, "--help", "--version"]),
        "values": "\n".join(_indented(values, 12)),
        "options": "\n".join(_indented(options, 20)),
    }


def _quoted(words: List[str]) -> str:
    return shlex.quote(" ".join(words))


def _indented(lines: List[str], by: int) -> Iterator[str]:
    return (" " * by + line for line in lines)
