"""A run over a prepared set: the files of `bench --predictions`, byte for byte."""

import threading
import warnings

import numpy as np
import pytest

import strat
from conftest import command, disparity

WORDS = {"model": "mine@7", "meaning": "disparity_fraction"}


def save(folder, maps, meaning):
    """Maps as another program saves them: a float32 array for each image."""
    folder.mkdir()
    (folder / "predictions.yaml").write_text(f"meaning: {meaning}\n")
    for name, values in maps.items():
        path = folder / f"{name}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, values)


def same_files(ours, theirs):
    """All but the record, which says how long it took."""
    names = sorted(path.name for path in theirs.iterdir())
    assert sorted(path.name for path in ours.iterdir()) == names and "rows.csv" in names
    for name in names:
        if name != "run.yaml":
            assert (ours / name).read_bytes() == (theirs / name).read_bytes(), name


def doubts(folder):
    """What the record of a run warns of."""
    record = (folder / "run.yaml").read_text()
    return record[record.index("\nwarnings:") : record.index("\nfailures:")]


def agrees(data, folder, protocols, meaning, convert=lambda fraction: fraction, metrics=False):
    run = strat.Run(data, protocols, model="mine@7", meaning=meaning, metrics=metrics)
    maps = {sample.id: convert(disparity(sample.image)) for sample in run}
    assert list(maps) == run.ids
    save(folder / "maps", maps, meaning)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # In another order than the set's.
        for name in sorted(maps, reverse=True):
            run.add(name, maps[name])
        incomplete = bool(run.failures)
        run.write(folder / "ours", incomplete=incomplete)
    more = [word for name in protocols for word in ("--protocol", name)]
    more += ["--metrics"] if metrics else []
    line = ["bench", "--table", "all", "--data", data, "--predictions", f"mine@7={folder / 'maps'}", *more]
    command(*line, "--out", folder / "theirs", "--quiet", code=int(incomplete))
    same_files(folder / "ours", folder / "theirs")
    assert doubts(folder / "ours") == doubts(folder / "theirs")
    # A terminal shows what fits its width; the files have all of it.
    tables = [file.read_text() for file in sorted((folder / "theirs").glob("table_*.txt"))]
    assert tables and all(table in run.table() for table in tables)
    return run


ALIGNED = ["eigen-80-affine-disparity", "eigen-80-scale-disparity"]
CASES = {
    "eigen": ("eigen", ["eigen-80", "eigen-50", "eigen-80-median"], "disparity_fraction", lambda map: map),
    "kitti": ("kitti", ["kitti2015", "semantic", "kitti2015-occ"], "disparity_fraction", lambda map: map),
    "aligned": ("eigen", ["eigen-80", "eigen-50", *ALIGNED], "inverse_depth", lambda map: 7 * map),
    "depth": ("eigen", ["eigen-80", "eigen-50"], "depth_m", lambda map: 0.3 / map),
    "no scale": ("eigen", ["eigen-80", "eigen-50"], "inverse_depth", lambda map: 40 * map),
    "metrics": ("eigen", ["eigen-80", "eigen-50", *ALIGNED], "disparity_fraction", lambda map: map, True),
    "suspected": ("eigen", ["eigen-80", "eigen-50"], "depth_m", lambda map: 300 / map),
}


@pytest.mark.parametrize("case", CASES)
def test_rows_of_rendered_frames_are_those_of_the_command(sets, tmp_path, case):
    name, *rest = CASES[case]
    agrees(sets / name, tmp_path, *rest)


@pytest.mark.parametrize("case", ["eigen", "no scale"])
def test_rows_of_real_frames_are_those_of_the_command(real_sets, tmp_path, case):
    name, *rest = CASES[case]
    agrees(real_sets / name, tmp_path, *rest)


def test_real_stereo_frames_are_those_of_the_command(real_sets, tmp_path):
    agrees(real_sets / "kitti", tmp_path, ["kitti2015"], "disparity_fraction")


def measured(eigen, **words):
    run = strat.Run(eigen, **(WORDS | words))
    for sample in run:
        run.add(sample.id, disparity(sample.image))
    return run


def test_what_a_run_says(eigen):
    run = measured(eigen)
    assert len(run) == len(run.ids) > 1 and not run.missing and not run.failures
    assert run.protocols == ["eigen-80", "eigen-50"]
    figure = run.summary()["eigen-80"]["abs_rel"]
    values = [row["abs_rel"] for row in run.rows().records() if row["protocol"] == "eigen-80"]
    assert figure.value == pytest.approx(np.mean(values)) and figure.images == len(run)
    assert "Table 3.3" in run.table() and "mine@7" in run.table()


def test_samples_have_their_images_and_cameras(eigen):
    run = strat.Run(eigen, threads=1, **WORDS)
    by_hand = {sample["id"]: sample for sample in strat.PreparedSet(eigen).test}
    for sample in run:
        assert sample.image.dtype == np.uint8 and sample.image.shape[2] == 3
        assert np.array_equal(sample.image, by_hand[sample.id]["image"])
        assert sample.focal_px == by_hand[sample.id]["focal_px"]
        assert sample.baseline_m == by_hand[sample.id]["baseline_m"]


def test_what_the_first_images_let_suspect_is_said_at_once(eigen):
    run = strat.Run(eigen, model="m", meaning="depth_m")
    *others, last = list(run)[:8]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for sample in others:
            run.add(sample.id, disparity(sample.image))
    with pytest.warns(UserWarning, match="near and far are exchanged"):
        run.add(last.id, disparity(last.image))
    assert any("near and far are exchanged" in text for text in run.warnings)


def test_further_metrics_are_measured_when_asked(eigen):
    further = measured(eigen, metrics=True)
    assert {"silog", "log10", "irmse", "mae", "sq_rel_2"} <= further.summary()["eigen-80"].keys()
    plain = measured(eigen)
    assert "silog" not in plain.summary()["eigen-80"]
    name = further.ids[0]
    of_image = lambda run: next(row for row in run.rows().records() if row["image"] == name)
    assert of_image(plain)["abs_rel"] == of_image(further)["abs_rel"] and "mae" not in of_image(plain)
    assert of_image(further)["mae"] > 0


def test_maps_come_from_any_thread(eigen, tmp_path):
    run = strat.Run(eigen, **WORDS)
    samples = list(run)
    mistakes = []

    def work(part):
        for sample in part:
            try:
                run.add(sample.id, disparity(sample.image))
            except ValueError as error:
                mistakes.append(str(error))

    # Each image is handed over by two of the threads, and only one of them is told so.
    threads = [threading.Thread(target=work, args=(samples[start:] + samples[:start],)) for start in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(mistakes) == len(samples) and all("has a map already" in text for text in mistakes)
    run.rows().write(tmp_path / "rows.csv")
    measured(eigen).rows().write(tmp_path / "again.csv")
    assert (tmp_path / "rows.csv").read_bytes() == (tmp_path / "again.csv").read_bytes()


def test_what_is_missing_is_named(eigen, tmp_path):
    run = strat.Run(eigen, **WORDS)
    first, *rest = run
    run.add(first.id, disparity(first.image))
    assert run.missing == [sample.id for sample in rest]
    with pytest.raises(ValueError, match=f"{len(rest)} of {len(run)} test images lack rows, such as {rest[0].id}"):
        run.write(tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.warns(UserWarning, match="are `scale`, `meaning`, baseline and focal length"):
        run.write(tmp_path / "out", incomplete=True)
    assert rest[0].id in (tmp_path / "out" / "failures.csv").read_text()


def test_a_map_that_is_refused_leaves_the_run_as_it_was(eigen):
    run = strat.Run(eigen, **WORDS)
    name = run.ids[0]
    good = disparity(np.zeros((9, 9, 3), dtype=np.uint8))
    broken = good.copy()
    broken[1, 2] = np.inf
    for image, values, sentence in [
        (name, broken, f"image {name}: the map is not a number at row 1, column 2"),
        (name, good * 100, "are these pixels"),
        (name, good.T, "swapped"),
        (name, good.astype(int), f"image {name}: its type is `int64`"),
        ("nobody", good, "image nobody: it is none of the"),
    ]:
        with pytest.raises(ValueError) as raised:
            run.add(image, values)
        assert sentence in str(raised.value)
    assert run.missing == run.ids
    run.add(name, good)
    with pytest.raises(ValueError, match="has a map already"):
        run.add(name, good)


def test_results_of_another_run_are_left_alone(eigen, tmp_path):
    run = strat.Run(eigen, **WORDS)
    for sample in run:
        run.add(sample.id, disparity(sample.image, seed=1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        measured(eigen).write(tmp_path)
        rows = (tmp_path / "rows.csv").read_bytes()
        # The same once more is no other run.
        measured(eigen).write(tmp_path)
        with pytest.raises(OSError, match="results of another file under the name mine@7"):
            run.write(tmp_path)
        assert (tmp_path / "rows.csv").read_bytes() == rows
        run.write(tmp_path, force=True)
    assert (tmp_path / "rows.csv").read_bytes() != rows


def test_runs_that_cannot_be(sets, eigen, tmp_path):
    for data, words, kind, sentence in [
        (tmp_path / "none", {}, OSError, "folder not found"),
        (eigen, {"protocols": ["kitti2015"]}, ValueError, "stereo 2015 ground truth"),
        (eigen, {"protocols": ["eigen-80-pp"]}, ValueError, "mirrored images"),
        (eigen, {"protocols": "eigen-80"}, ValueError, "a list of names"),
        (eigen, {"meaning": "metres"}, ValueError, "unknown meaning"),
        (eigen, {"scale": -1.0}, ValueError, "`scale` must be a positive number"),
        (eigen, {"protocols": []}, ValueError, "at least one protocol is needed"),
        (eigen, {"model": ""}, ValueError, "a model name that is not empty is needed"),
        (eigen, {"threads": 0}, ValueError, "at least one thread"),
    ]:
        with pytest.raises(kind, match=sentence):
            strat.Run(data, **(WORDS | words))
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(OSError, match="file"):
        measured(eigen).write(file)
