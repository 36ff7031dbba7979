"""The benchmark of the executors compares what they answer with one process."""

import json
from contextlib import contextmanager

import pytest

from benchmarks import executors


@pytest.fixture
def no_cluster(monkeypatch):
    @contextmanager
    def cluster():
        yield "tcp://nowhere:1"

    monkeypatch.setattr(executors, "_cluster", cluster)


@pytest.mark.parametrize("wrong", [True, False])
def test_it_fails_where_an_executor_answers_differently(no_cluster, monkeypatch, capsys, wrong):
    def answered(words, executor):
        return {"words": words, "other": wrong and executor.startswith("dask:")}, 2.0

    monkeypatch.setattr(executors, "answered", answered)
    assert executors.main(["--json"]) == int(wrong)
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["on"] for row in rows] == ["local", "processes:2", "dask"] * 2
    assert [row["same"] for row in rows] == [True, True, not wrong] * 2
    assert executors.main([]) == int(wrong)
    assert "| dask |" in " ".join(capsys.readouterr().out.split())


def test_a_command_is_measured_as_a_user_types_it():
    for _, words in executors.commands(0.0):
        found, seconds = executors.answered(words, "local")
        assert found and seconds > 0
