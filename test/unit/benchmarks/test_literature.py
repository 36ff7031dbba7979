"""The command that computes published values anew: it agrees, and would fail if it did not."""

import doctest
import json
from pathlib import Path

import pytest

from benchmarks.literature import __main__ as literature
from benchmarks.literature import comparing
from benchmarks.literature.answers import Between, Subject
from benchmarks.literature.published import FILE, Published, read_published
from benchmarks.literature.questions import FAMILIES, VISITING
from benchmarks.nets import machines

VALUES = read_published(FILE.read_text("utf-8"))


@pytest.mark.parametrize(
    ("family", "size"),
    [("philosophers", 4), ("tandem", 5), ("stream", 10), ("jobs", 5), ("museum", 1)],
)
def test_small_nets_are_as_published(family, size):
    group = [v for v in VALUES if (v.family, v.size) == (family, size)]
    rows = comparing.compare(group)
    assert {row.verdict for row in rows} == {comparing.AGREES}
    assert all(row.ours.certified for row in rows)


def test_a_value_that_differs_is_reported(capsys, monkeypatch, tmp_path):
    text = "source exact: nobody\nfamily philosophers size states deadlock_time\n4 34 5.4455\n"
    (tmp_path / "published.txt").write_text(text, "utf-8")
    monkeypatch.setattr(literature, "FILE", tmp_path / "published.txt")
    monkeypatch.setattr(
        literature, "compare_all", lambda groups, *_: map(comparing.compare, groups)
    )
    assert literature.main([]) == 1
    assert "1 agree, 0 published ones are wrong, 1 differ or have no answer" in (
        capsys.readouterr().out
    )
    assert literature.main(["--json"]) == 1
    values = json.loads(capsys.readouterr().out)["values"]
    assert [value["verdict"] for value in values] == ["agrees", "DIFFERS"]


@pytest.mark.parametrize(
    ("kind", "text", "is_wrong", "verdict"),
    [
        ("exact", "5.445544554455446", False, comparing.AGREES),
        ("exact", "5.445544554455546", False, comparing.DIFFERS),
        ("default", "5.4501", False, comparing.AGREES),
        ("default", "5.4511", False, comparing.DIFFERS),
        ("printed", "5.446", False, comparing.AGREES),
        ("printed", "5.444", False, comparing.DIFFERS),
        ("sound", "5.4455..5.4456", False, comparing.AGREES),
        ("sound", "5.4456..5.4457", False, comparing.DIFFERS),
        ("measured", "5.4+-0.03", False, comparing.AGREES),
        ("measured", "5.4+-0.02", False, comparing.DIFFERS),
        ("default", "5.6", True, comparing.EXPLAINED),
        ("default", "5.446", True, comparing.STALE),
    ],
)
def test_how_close_a_value_must_be(kind, text, is_wrong, verdict):
    value = Published("philosophers", 4, "deadlock_time", text, kind, "somebody", is_wrong)
    (row,) = comparing.compare([value])
    assert row.verdict == verdict
    assert row.fails == (verdict in (comparing.DIFFERS, comparing.STALE))


def test_what_has_no_answer_fails():
    value = Published("erlang", 10, "goal_time", "2", "exact", "somebody")
    (row,) = comparing.compare([value._replace(family="courier", size=1, answer="states")])
    assert row.fails  # 29,010 states
    (row,) = comparing.compare([value])
    assert not row.fails


def test_every_published_value_can_be_asked():
    assert len(VALUES) >= 300
    assert len({literature.id_of(value) for value in VALUES}) == len(VALUES)
    for value in VALUES:
        assert value.answer in {**VISITING, **FAMILIES[value.family].answers}
        assert value.kind in ("exact", "sound", "default", "printed", "measured") and value.source
        assert value.lower <= value.upper


def test_the_proofs_of_the_document_hold():
    document = Path(__file__).parents[3] / "docs" / "literature.md"
    result = doctest.testfile(str(document), module_relative=False)
    assert result.attempted >= 4 and not result.failed


def test_unknown_families_are_refused(capsys):
    assert literature.main(["nobody"]) == 2
    assert "there are no nets 'nobody'" in capsys.readouterr().err


def test_answers_by_uniformisation_hold_the_value():
    """Of a machine that breaks: everything is known in closed form."""
    subject = Subject(machines(1))  # idle 1/s, works 2/s
    assert subject.long_run({"idle1": 1.0}).lower <= 2 / 3 <= subject.long_run({"idle1": 1.0}).upper
    spent = subject.during(2.0, {"idle1": 1.0})
    exact = 2 * 2 / 3 + (1 - 2.718281828459045 ** (-6.0)) / 9
    assert spent.lower <= exact <= spent.upper
    assert spent.upper - spent.lower < 1e-9
    assert isinstance(spent, Between)
