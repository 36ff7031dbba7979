"""The benchmark of exchanged parts compares them with the whole, and would fail if they
differed."""

import json

from benchmarks import lumping
from benchmarks.nets import machines


def test_small_nets_are_compared_and_large_ones_are_not(monkeypatch, capsys):
    monkeypatch.setattr(lumping, "NETS", [(machines, "end1", (3, 30))])
    assert lumping.main(["--largest", "1000", "--json"]) == 0
    small, large = json.loads(capsys.readouterr().out)
    assert small["verdict"] == "the same" and small["visited"] < small["total"]
    assert large["verdict"] == "not compared" and large["visited"] < 100
    assert lumping.main(["--largest", "1000"]) == 0
    assert "| machines 3 " in capsys.readouterr().out


def test_a_difference_is_reported(monkeypatch, capsys):
    analyse = lumping.timed

    def wrong(net, transition, lump=None):
        found = analyse(net, transition, lump)
        return found if lump is None else found._replace(throughput=found.throughput + 1e-6)

    monkeypatch.setattr(lumping, "timed", wrong)
    monkeypatch.setattr(lumping, "NETS", [(machines, "end1", (3,))])
    assert lumping.main(["--json"]) == 1
    assert json.loads(capsys.readouterr().out)[0]["verdict"] == "differs"
