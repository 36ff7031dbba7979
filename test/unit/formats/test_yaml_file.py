"""YAML files become plain data, or are refused with a line, whatever is in them."""

from __future__ import annotations

import json
import string
from pathlib import Path
from typing import Any, Union

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.formats.yaml_file import MOST_LEVELS, YamlDocument, path_text, read_yaml
from gspn_framework_package.model.errors import InputError

TEXT = """a: 1
b:
  c: [x, {d: 2},
    y]
"""

PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(string.printable.replace("\x0b", "").replace("\x0c", "")),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(string.ascii_letters), inner),
    max_leaves=20,
)


def refusal(text: Union[str, bytes], **options: Any) -> InputError:
    with pytest.raises(InputError) as caught:
        YamlDocument(text, "some.yaml", **options)
    assert caught.value.file == "some.yaml"
    return caught.value


@pytest.mark.long
@settings(derandomize=True, max_examples=50, deadline=None)
@given(PLAIN)
def test_json_is_read_as_it_is(data: Any) -> None:
    assert YamlDocument(json.dumps(data)).data == data


@settings(derandomize=True, max_examples=150, deadline=None)
@given(st.binary(max_size=40) | st.text("[]{}:,-&*!<>|? \n\tab1\"'", max_size=40))
def test_anything_else_is_refused(text: Union[str, bytes]) -> None:
    try:
        YamlDocument(text)
    except InputError as error:
        assert len(str(error).splitlines()) == 1


@pytest.mark.parametrize("opening", ["[", "{a: ", "- ", "? "])
def test_deep_nesting_is_refused_before_it_ends_the_process(opening: str) -> None:
    assert "nested too deeply" in refusal("a: 1\n---\n" + opening * 100_000).message
    assert "nested too deeply" in refusal("\n" + "[" * (MOST_LEVELS + 1)).message
    assert YamlDocument("[" * MOST_LEVELS + "]" * MOST_LEVELS).data


@pytest.mark.parametrize(
    "text, line, said",
    [
        ("a: 1\nb: \0", 2, "the character #x0000"),
        (b"a: 1\nb: \xff", 2, "the character #x00ff"),
        ("a: 1\nb: [", 2, "it is not YAML"),
        ("a: 1\nb: !!python/name:os.abort ''", 2, "tag '!!python/name:os.abort' is not plain"),
        ("a: 1\nb: !mine 2", 2, "tag '!mine' is not plain"),
        ("a: 1\na: 2", 2, "the key 'a' occurs twice"),
        ("a: 1\nb: &b [*b]", 2, "contains itself"),
        ("a: 1\nb: 2026-13-45", 2, "is not a value of its kind"),
        ("# nothing", None, "the file is empty"),
    ],
)
def test_a_refusal_has_the_line(text: Union[str, bytes], line: int, said: str) -> None:
    error = refusal(text)
    assert said in error.message and error.line == line


def test_the_reader_says_how_many_elements_there_may_be() -> None:
    error = refusal("[1, 2,\n3]", limit=3)
    assert "more than 3 elements" in error.message and error.line == 2
    assert "more than 5 elements" in refusal("[&a [1, 2], *a]", limit=5).message
    assert YamlDocument("[1, 2, 3]", limit=4).data == [1, 2, 3]


def test_elements_have_lines(tmp_path: Path) -> None:
    path = tmp_path / "some.yaml"
    path.write_text(TEXT)
    document = read_yaml(str(path))
    assert [document.line(p) for p in (["a"], ["b", "c", 1, "d"], ["b", "c", 2])] == [1, 3, 4]
    assert document.line(["b", "c", 9]) == document.line(["b", "c", "no"]) == 3
    assert document.line([], "b") == 2
    error = document.error("it is bad", ["b", "c", 1, "d"], "make it good")
    assert str(error) == "%s:3: b.c[1].d: it is bad (make it good)" % path
    assert path_text([]) == ""
    with pytest.raises(InputError, match="cannot read it"):
        read_yaml(str(tmp_path / "none.yaml"))
