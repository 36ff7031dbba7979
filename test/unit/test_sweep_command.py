"""``gspn sweep``: its table, its store, its picture."""

import csv
import json
from pathlib import Path

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.cli.sweep_store import SUFFIX

TOKENS = str(Path(__file__).parents[2] / "plans" / "tokens")
HOW = ["--time", "5", "--replications", "20", "--measure", "t1"]


@pytest.fixture
def sweep(tmp_path, capsys):
    def run(*words, plan=TOKENS, code=0):
        path = tmp_path / "results.csv"
        assert main(["sweep", plan, *HOW, "--output", str(path), *words]) == code
        out, err = capsys.readouterr()
        rows = list(csv.DictReader(path.open())) if path.exists() else []
        return out or err, rows

    run.store = tmp_path / ("results.csv" + SUFFIX)
    return run


def test_the_table_has_a_row_for_each_point_and_measure(sweep):
    out, rows = sweep("--vary", "robots=1..2", "--vary", "rate:t1=1,2", "--measure", "p1")
    assert [(row["robots"], row["rate:t1"]) for row in rows[::2]] == [
        ("1", "1.0"),
        ("1", "2.0"),
        ("2", "1.0"),
        ("2", "2.0"),
    ]
    assert {(row["measure"], row["name"]) for row in rows} == {
        ("throughput", "t1"),
        ("mean_tokens", "p1"),
    }
    assert all(float(row["mean"]) > 0 < float(row["half_width"]) for row in rows)
    assert out.splitlines()[0] == "4 points, 0 of them known before"


def test_a_second_run_measures_only_what_is_missing(sweep):
    _, first = sweep("--vary", "robots=1..2")
    written = sweep.store.read_bytes()
    out, second = sweep("--vary", "robots=1..3")
    assert out.startswith("3 points, 2 of them known before")
    assert second[:2] == first
    assert sweep.store.read_bytes().startswith(written)
    out, _ = sweep("--vary", "robots=1..3", "--seed", "1")
    assert out.startswith("3 points, 0 of them known before")


def test_a_line_that_was_cut_off_is_measured_again(sweep):
    _, first = sweep("--vary", "robots=1..2")
    whole = sweep.store.read_bytes()
    sweep.store.write_bytes(whole[:-10])
    out, again = sweep("--vary", "robots=1..2")
    assert out.startswith("2 points, 1 of them known before")
    assert again == first
    assert sweep.store.read_bytes() == whole


@pytest.mark.parametrize("line", ["{}", "no", '{"key": 1, "replications": 1, "measures": {}}'])
def test_a_file_that_is_no_store_is_refused_and_stays(sweep, line):
    sweep.store.write_text('{"gspn_sweep": 1}\n%s\n' % line)
    before = sweep.store.read_bytes()
    err, rows = sweep("--vary", "robots=1..2", code=2)
    assert SUFFIX + ":2: this is not a point of a sweep" in err
    assert not rows
    assert sweep.store.read_bytes() == before


def test_json_and_policies_of_files(sweep, tmp_path):
    policy = tmp_path / "other.json"
    policy.write_text('{"places": [], "rows": []}')
    out, _ = sweep("--vary", "policy=%s,%s" % (TOKENS, policy), "--json")
    data = json.loads(out)
    assert [point["values"]["policy"] for point in data["points"]] == [TOKENS, str(policy)]
    assert data["points"][0]["measures"]["throughput"]["t1"]["mean"] > 0
    assert data["vary"] == [{"name": "policy", "values": [TOKENS, str(policy)]}]
    assert (data["kept"], data["exact"], data["seed"]) == (0, False, 0)


def test_the_picture_is_drawn(sweep, tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "sweep.svg"
    sweep("--vary", "robots=1..2", "--vary", "rate:t1=1,2", "--plot", str(picture))
    assert b"<svg" in picture.read_bytes()
    err, _ = sweep("--vary", "robots=1", "--plot", "sweep.txt", code=2)
    assert "a picture must end in" in err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--vary", "robots=0"], "'0' is not a number of robots"),
        (["--vary", "rate:t99=1"], "rate:t99=1.0: there is no exponential transition 't99'"),
        (["--vary", "policy=/no/file.json"], "/no/file.json"),
        (["--vary", "robots=1", "--measure", "t99"], "there is no 't99' to measure"),
        (["--vary", "robots=1", "--on", "moon"], "--on moon"),
    ],
)
def test_wrong_words_are_named(sweep, words, message):
    err, rows = sweep(*words, code=2)
    assert message in err
    assert not rows
