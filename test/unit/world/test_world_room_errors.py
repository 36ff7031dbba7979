"""Room files that are no good: each is refused with one clear message that names the line."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.room_file import load_room, parse_room

GOOD = """\
name: small
walls:
  - [[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]
locations:
  A:
    area: [[-0.5, -0.5], [0.5, 0.5]]
    entry: [-0.75, 0]
    sweep: [[0, 0]]
    bay:
      - [0.75, 0.5]
      - [0.75, -0.5]
spawn:
  - [-0.75, 0]
"""
LAST = len(GOOD.splitlines())


def refusal(text):
    """The error of a room file that is refused; nothing but an InputError will do."""
    with pytest.raises(InputError) as refused:
        parse_room(text, "room.yaml")
    error = refused.value
    assert error.exit_code == 2
    assert str(error).startswith("room.yaml:")
    assert "\n" not in str(error)
    assert len(str(error)) < 500
    return error


@pytest.mark.parametrize(
    "old, new, line, words",
    [
        (
            "name: small",
            "nome: small",
            1,
            "there is no key 'nome' here (did you mean 'name'?; 1 more)",
        ),
        ("name: small", "", 2, "the key 'name' is missing"),
        ("name: small", "name: [small]", 1, "name: ['small'] is not a text"),
        (
            "    entry:",
            "    entri:",
            7,
            "locations.A: there is no key 'entri' here (did you mean 'entry'?",
        ),
        ("walls:", "walls: [", 3, "not YAML"),
        ("  - [[-1, -1], [1, -1]", "\t- [[-1, -1], [1, -1]", 3, "not YAML"),
        ("[[0, 0]]", "[]", 8, "locations.A.sweep: it has 0 entries, and needs 1 or more"),
        ("[[0, 0]]", "[[0, 0, 0]]", 8, "locations.A.sweep[0]: it has 3 entries, and needs 2"),
        ("entry: [-0.75, 0]", "entry: west", 7, "locations.A.entry: 'west' is not a list"),
        (
            "[-0.75, 0]\n    sweep",
            "[-0.75, zero]\n    sweep",
            7,
            "locations.A.entry[1]: 'zero' is not a finite number",
        ),
        ("[[0, 0]]", "[[.nan, 0]]", 8, "nan is not a finite number"),
        ("[[0, 0]]", "[[0, -.inf]]", 8, "-inf is not a finite number"),
        ("[[0, 0]]", "[[true, 0]]", 8, "True is not a finite number"),
        ("[[0, 0]]", "[[1%s, 0]]" % ("0" * 400), 8, "greater than the maximum of 10000"),
        ("[[0, 0]]", "[[1%s, 0]]" % ("0" * 5000), 8, ""),
        ("entry: [-0.75, 0]", "entry: [-0.55, 0]", 7, "would be in the area"),
        ("[[0, 0]]", "[[0, 0], [0.7, 0]]", 8, "sweep[1]: the point is not in the area"),
        ("[0.75, -0.5]", "[0.75, 0.45]", 11, "overlap"),
        (
            "spawn:\n  - [-0.75, 0]",
            "spawn:\n  - [-0.9, 0]",
            13,
            "spawn[0]: a robot does not fit there",
        ),
        (
            "spawn:\n  - [-0.75, 0]",
            "spawn:\n  - [-1, 0]",
            13,
            "spawn[0]: a robot does not fit there",
        ),
        ("spawn:\n", "spawn:\n  - [3, 0]\n", 14, "spawn[1]: no path leads from there to spawn[0]"),
        ("[[-0.5, -0.5], [0.5, 0.5]]", "[[0.5, 0.5], [-0.5, -0.5]]", 6, "no interior"),
        ("spawn:", "name: again\nspawn:", 12, "the key 'name' occurs twice"),
        ("name: small", "name: &n [*n]", 1, "an alias that contains itself"),
        ("name: small", "name: *n", 1, "undefined alias"),
        ("name: small", "name: !!python/object/apply:os.abort []", 1, "not plain data"),
        ("name: small", "name: 2026-13-45", 1, "not YAML"),
        ("name: small", "name: \0", 1, "not YAML"),
        ("name: small", "? [a, b]\n: small", 1, "not YAML"),
    ],
)
def test_a_bad_room_is_refused_with_its_line(old, new, line, words):
    parse_room(GOOD)
    assert old in GOOD
    error = refusal(GOOD.replace(old, new, 1))
    assert words in str(error)
    assert error.line == line


@pytest.mark.parametrize(
    "more, words",
    [
        ("robot: {max_speed: 0}", "robot.max_speed"),
        ("robot: {radius: 0.0001}", "less than the minimum"),
        ("robot: {scan_rays: 1000000}", "greater than the maximum"),
        ("robot: {scan_rays: 2.5}", "2.5 is not a whole number"),
        (
            "temperature: {hot_spots: [{path: [[0, 0]], excess: 5, radius: -1}]}",
            "hot_spots[0].radius",
        ),
        (
            "cylinders: [{at: [0.9, 0.9], radius: 0.01, color: red}]",
            "'red' is not a colour such as #ffcc00",
        ),
        ("5: five", "there is no key '5' here"),
        ("---\nname: second", "not YAML"),
    ],
)
def test_a_bad_addition_is_refused_with_its_line(more, words):
    error = refusal(GOOD + more)
    assert words in str(error)
    assert error.line == LAST + 1


@pytest.mark.long
@pytest.mark.parametrize(
    "text, words",
    [
        ("", "the file is empty"),
        ("# to do\n", "the file is empty"),
        ("hello", "'hello' is not a mapping"),
        ("- 1", "is not a mapping"),
        ("name: x\nwalls: " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("name: x\nwalls: [[[0, 0], [9000, 0], [9000, 9000]]]", "too large: 9000 m x 9000 m"),
    ],
)
def test_what_is_no_room_at_all_is_refused(text, words):
    assert words in str(refusal(text))


def test_aliases_that_unfold_into_thousands_of_millions_are_refused():
    text = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n"
    for level in range(1, 10):
        text += "a%d: &a%d [%s]\n" % (level, level, ", ".join(["*a%d" % (level - 1)] * 10))
    assert "more than 200000 elements" in str(refusal(text + "name: x\nwalls: *a9\n"))


def test_a_wall_without_a_door_is_reported_where_it_cuts_off_the_bay():
    error = refusal(GOOD + "boxes: [{at: [0.4, 0], size: [0.1, 2]}]\n")
    assert "locations.A.bay[0]: no path leads from there to spawn[0]" in str(error)
    assert error.line == 10


def test_aliases_and_merges_are_welcome():
    text = "name: x\nwalls: []\nboxes: [&b {at: [0, 0], size: [1, 1]}, {<<: *b, at: [5, 5]}]\nspawn: [&p [2, 2], [3, 3]]\n"
    room = parse_room(text)
    assert [box.at for box in room.obstacles] == [(0.0, 0.0), (5.0, 5.0)]
    assert room.obstacles[1].size == (1.0, 1.0)


def test_a_file_that_cannot_be_read_is_an_input_error(tmp_path):
    for name in ("none.yaml", "."):
        with pytest.raises(InputError, match="cannot read the room"):
            load_room(tmp_path / name)
    binary = tmp_path / "room.yaml"
    binary.write_bytes(b"\xff\xfe\x00name")
    with pytest.raises(InputError, match="cannot read the room"):
        load_room(binary)


LINES = GOOD.splitlines(keepends=True)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, len(GOOD)), st.text(min_size=1, max_size=1)), max_size=4),
    st.integers(0, 60),
)
def test_whatever_is_typed_or_cut_it_is_a_room_or_an_input_error(typed, cut):
    text = GOOD[: len(GOOD) - cut]
    for at, character in typed:
        text = text[:at] + character + text[at:]
    try:
        parse_room(text, "room.yaml")
    except InputError as error:
        assert "\n" not in error.message
