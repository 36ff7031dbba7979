"""Broken files: one clear message each, no traceback, and exit code 2 of the command line."""

import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import read_net, source
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.model.net import Net

DATA = Path(__file__).parent / "data"
SAMPLES = sorted(path for path in DATA.iterdir())
RELAXED = settings(
    max_examples=50,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
BOMB = "<!DOCTYPE pnml [<!ENTITY e0 'xxxxxxxxxx'>%s]>" % "".join(
    "<!ENTITY e%d '%s'>" % (n, "&e%d;" % (n - 1) * 10) for n in range(1, 12)
)
BROKEN = {
    "empty": (b"", "the file is empty"),
    "blank": (b" \n\t", "the file is empty"),
    "cut": ((DATA / "pipe_2.xml").read_bytes()[:900], "not well-formed XML"),
    "wrong root": (
        b"<html><body/></html>",
        "the root element <html> belongs to no known net format",
    ),
    "bomb in text": (("%s<pnml><net>&e11;</net></pnml>" % BOMB).encode(), "declares XML entities"),
    "bomb in attribute": (("%s<pnml id='&e11;'/>" % BOMB).encode(), "declares XML entities"),
    "bomb unused": (("%s<pnml/>" % BOMB).encode(), "declares XML entities"),
    "bomb in UTF-16": (("%s<pnml/>" % BOMB).encode("utf-16"), "declares XML entities"),
    "external entity": (
        b"<!DOCTYPE pnml [<!ENTITY e SYSTEM 'file:///etc/passwd'>]><pnml>&e;</pnml>",
        "declares XML entities",
    ),
    "external parameter entity": (
        b"<!DOCTYPE pnml [<!ENTITY % e SYSTEM 'http://localhost/x'> %e;]><pnml/>",
        "declares XML entities",
    ),
    "undeclared entity": (b"<pnml><net>&e;</net></pnml>", "not well-formed XML"),
    "no net": (b"<pnml/>", "there is no net in the file"),
    "no node": (b"<pnml><net/></pnml>", "no place and no transition"),
    "deep": (b"<pnml>" + b"<net>" * 100_000, "not well-formed XML"),
    "JSON": (b'{"net": "x.xml"}', "this is JSON, not a net"),
    "text": (b"hello world", "not a net in any format that is known"),
    "binary": (bytes(range(256)) * 4, "neither XML nor text"),
    "drawing of TINA": (b"p 60 60 {p 1} 1 n\nt 120.5 60 t1 0 w n\n", "save it from nd as .net"),
    "old GreatSPN": (b"|0|\n|\nf 0 1", "old .net/.def format of GreatSPN"),
    "not a number": (
        b"<pnml><net><place id='p'><initialMarking><value>1e999</value></initialMarking></place>"
        b"</net></pnml>",
        "has no finite real value",
    ),
    "deep expression": (
        b"<project><gspn name='n'><nodes><place name='p' marking='"
        + b"(" * 5000
        + b"'/></nodes></gspn></project>",
        "nested more than",
    ),
    "long expression": (
        b"<project><gspn name='n'><nodes><place name='p' marking='"
        + b"1+" * 500_000
        + b"1'/></nodes></gspn></project>",
        "characters, more than",
    ),
}


def one_line(text):
    return text.startswith("gspn: error: ") and len(text.splitlines()) == 1 and len(text) < 500


@pytest.mark.parametrize("name", BROKEN)
def test_one_clear_message_and_exit_code_2(name, tmp_path, capsys):
    data, message = BROKEN[name]
    path = tmp_path / "broken.net"
    path.write_bytes(data)
    start = time.monotonic()
    assert main(["convert", str(path), str(tmp_path / "out.xml")]) == 2
    assert time.monotonic() - start < 20
    shown = capsys.readouterr().err
    assert one_line(shown), shown
    assert message in shown
    assert str(path) in shown
    assert not (tmp_path / "out.xml").exists()


def test_a_file_that_is_not_there(tmp_path, capsys):
    assert main(["convert", str(tmp_path / "none.xml"), "-", "--to", "pnml"]) == 2
    assert "No such file" in capsys.readouterr().err
    assert main(["convert", str(DATA), "-", "--to", "pnml", "--from", "pipe"]) == 2
    assert "it is a folder, not a file" in capsys.readouterr().err


@pytest.mark.parametrize("size", [100_000_000, 10_000_000_000])
def test_a_huge_file_is_refused_at_once(tmp_path, capsys, size):
    path = tmp_path / "huge.xml"
    with path.open("wb") as file:
        file.write(b"<pnml>")
        file.truncate(size)
    assert main(["convert", str(path), str(tmp_path / "out.pnml")]) == 2
    assert "larger than 90 MB" in capsys.readouterr().err


def test_an_endless_file_is_refused():
    with pytest.raises(InputError, match="it is a device, not a file"):
        read_net("/dev/zero")


def test_a_missing_folder_to_write_to(tmp_path, capsys):
    assert main(["convert", str(DATA / "pipe_2.xml"), str(tmp_path / "no" / "out.xml")]) == 2
    assert one_line(capsys.readouterr().err)


def read_or_refuse(path):
    """Read a file that may be anything: a net, or one clear error."""
    try:
        net = read_net(path)
    except InputError as error:
        assert str(path) in str(error)
        assert "\n" not in str(error)
        assert len(str(error)) < 1000
    else:
        assert isinstance(net, Net)


@pytest.mark.long
@pytest.mark.parametrize("prefix", [b"", b"<", b"<pnml>", b"<project>", b"tr ", b"\xff\xfe<\0"])
@RELAXED
@given(data=st.binary(max_size=300))
@example(data=b"\0")
def test_random_bytes(tmp_path, prefix, data):
    path = tmp_path / "random"
    path.write_bytes(prefix + data)
    read_or_refuse(path)


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda path: path.name)
@RELAXED
@given(data=st.data())
def test_damaged_files(tmp_path, sample, data):
    """Pieces of a good file cut out, doubled and replaced: read, or refused with one message."""
    whole = sample.read_bytes()
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(whole)))
        end = data.draw(st.integers(start, min(len(whole), start + 40)))
        piece = data.draw(
            st.one_of(
                st.just(b""),
                st.just(whole[start:end] * 2),
                st.binary(max_size=6),
                st.sampled_from([b"-1", b"9" * 30, b"1e400", b"((", b"nan", b"<a>", b"'\"", b"#"]),
            )
        )
        whole = whole[:start] + piece + whole[end:]
    path = tmp_path / "damaged"
    path.write_bytes(whole)
    read_or_refuse(path)


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "net.xml"
    path.write_bytes(b"old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(source.os, "replace", full)
    with pytest.raises(InputError, match="No space left"):
        source.write_bytes(path, b"new")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["net.xml"]
