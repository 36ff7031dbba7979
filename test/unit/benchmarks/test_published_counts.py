"""The command that finds the published state counts anew: it agrees, and would fail if it did
not."""

import json

from benchmarks import published


def test_small_nets_are_as_published(capsys):
    assert published.main(["--largest", "50", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["nets"]
    assert [(row["net"], row["verdict"]) for row in found] == [("philosophers 4", "as published")]
    assert found[0]["peak_mb"] > 0


def test_a_count_that_differs_is_reported(capsys, monkeypatch):
    wrong = published.Published("philosophers", 4, 35, None, "nobody")
    monkeypatch.setattr(published, "COUNTS", [wrong])
    assert published.main([]) == 1
    assert "differs" in capsys.readouterr().out


def test_what_does_not_fit_is_left_out(capsys, monkeypatch):
    monkeypatch.setattr(
        published, "COUNTS", [published.Published("kanban", 99, 10**15, None, "nobody")]
    )
    assert published.main([]) == 0
    assert "left out: it takes about 120000000 GB of memory" in capsys.readouterr().out
