"""Functions of rows."""

import json

import numpy as np
import pytest

import strat
from conftest import command, disparity


@pytest.fixture(scope="module")
def results(sets, tmp_path_factory):
    """Results of two models on the rendered Eigen set."""
    folder = tmp_path_factory.mktemp("results")
    for name, seed in (("a", 0), ("b", 2)):
        run = strat.Run(sets / "eigen", model=name, meaning="disparity_fraction", metrics=True)
        for sample in run:
            run.add(sample.id, disparity(sample.image, seed))
        with pytest.warns(UserWarning) if run.warnings else np.errstate():
            run.write(folder / name)
    return folder


def test_rows_come_back_as_written(results, tmp_path):
    rows = strat.read_rows(results / "a" / "rows.csv")
    rows.write(tmp_path / "rows.csv")
    text = (results / "a" / "rows.csv").read_bytes()
    assert (tmp_path / "rows.csv").read_bytes() == text
    columns = rows.columns()
    header = text.decode().splitlines()[0].split(",")
    assert [name for name in columns if name in header] == header
    # Columns that the file does not have are empty.
    assert all(set(values) == {None} for name, values in columns.items() if name not in header)
    record = rows.records()[0]
    assert record["model"] == "a" and isinstance(record["abs_rel"], float) and isinstance(record["pixels"], int)
    assert record["group"] is None and len(rows) == len(rows.records())


def test_models_are_compared_as_the_command_does(results):
    files = [results / name / "rows.csv" for name in ("a", "b")]
    tests = strat.compare(*map(strat.read_rows, files), protocol="eigen-80")
    printed = command("bench", "compare", *files, "--protocol", "eigen-80", "--json")
    assert list(tests) == json.loads(printed.stdout)
    assert tests.text == command("bench", "compare", *files, "--protocol", "eigen-80").stdout
    one = strat.compare(strat.read_rows(*files), protocol="eigen-80")
    assert list(one) == list(tests)
    more = strat.compare(strat.read_rows(*files), protocol="eigen-80", metrics=True)
    line = ["bench", "compare", *files, "--protocol", "eigen-80", "--metrics", "--json"]
    assert list(more) == json.loads(command(*line).stdout) and len(more) == len(tests) + 5
    with pytest.raises(ValueError, match="a comparison needs rows of two models"):
        strat.compare(strat.read_rows(files[0]))


def test_tables_and_leaderboards_follow_from_rows(results):
    rows = strat.read_rows(results / "a" / "rows.csv")
    assert strat.table(rows) == (results / "a" / "table_3_3.txt").read_text()
    assert strat.table(rows, format="latex") == (results / "a" / "table_3_3.tex").read_text()
    lines = strat.leaderboard(rows)
    header, *text = (results / "a" / "leaderboard.csv").read_text().splitlines()
    header = header.split(",")
    assert [name for name in lines[0] if name in header] == header and len(lines) == len(text)
    measured = [line for line in lines if line["origin"] == "measured"]
    assert {line["method"] for line in measured} == {"a"} and isinstance(measured[0]["images"], int)


def test_rows_become_data_frames(results):
    pandas = pytest.importorskip("pandas")
    rows = strat.read_rows(results / "a" / "rows.csv")
    frame = rows.to_pandas()
    assert isinstance(frame, pandas.DataFrame) and len(frame) == len(rows)


def test_files_that_are_none(results, tmp_path):
    with pytest.raises(OSError, match="cannot read"):
        strat.read_rows(tmp_path / "none.csv")
    (tmp_path / "no.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match="no.csv"):
        strat.read_rows(tmp_path / "no.csv")
    with pytest.raises(ValueError, match="at least one"):
        strat.read_rows()
    with pytest.raises(ValueError, match="unknown format"):
        strat.table(strat.read_rows(results / "a" / "rows.csv"), format="html")
