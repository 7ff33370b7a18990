"""One image: what may be given, what is refused, and the figures beside numpy's own."""

import threading

import numpy as np
import pytest

import strat
from conftest import disparity

CAMERA = {"focal_px": 700.0, "baseline_m": 0.5}


def metrics(truth, predicted):
    """The seven of them as the published scripts compute them."""
    ratio = np.maximum(truth / predicted, predicted / truth)
    return {
        "abs_rel": np.mean(np.abs(truth - predicted) / truth),
        "sq_rel": np.mean((truth - predicted) ** 2 / truth),
        "rmse": np.sqrt(np.mean((truth - predicted) ** 2)),
        "rmse_log": np.sqrt(np.mean((np.log(truth) - np.log(predicted)) ** 2)),
        "a1": np.mean(ratio < 1.25),
        "a2": np.mean(ratio < 1.25**2),
        "a3": np.mean(ratio < 1.25**3),
    }


def scene(rows=20, columns=60):
    generator = np.random.default_rng(3)
    truth = generator.uniform(1, 90, (rows, columns)).astype(np.float32)
    truth[generator.random(truth.shape) < 0.5] = 0
    predicted = (truth + 10) * generator.uniform(0.8, 1.2, truth.shape).astype(np.float32)
    return predicted, truth


def test_depth_is_scored_as_numpy_scores_it():
    predicted, truth = scene()
    found = strat.evaluate(predicted, truth, protocol="eigen-80-nocrop", meaning="depth_m")
    mask = (truth > 1e-3) & (truth < 80)
    expected = metrics(truth[mask].astype(float), np.clip(predicted[mask], 1e-3, 80).astype(float))
    assert found["pixels"] == mask.sum()
    assert found["protocol"] == "eigen-80-nocrop" and found["group"] is None and found["d1_all"] is None
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-6), name


def test_further_metrics_are_those_of_numpy():
    predicted, truth = scene()
    words = {"protocol": "eigen-80-nocrop", "meaning": "depth_m"}
    found = strat.evaluate(predicted, truth, metrics=True, **words)
    mask = (truth > 1e-3) & (truth < 80)
    g, p = truth[mask].astype(float), np.clip(predicted[mask], 1e-3, 80).astype(float)
    logs = np.log(p) - np.log(g)
    for name, value in {
        "silog": 100 * np.std(logs),
        "log10": np.mean(np.abs(np.log10(p) - np.log10(g))),
        "irmse": np.sqrt(np.mean((1000 / p - 1000 / g) ** 2)),
        "mae": np.mean(np.abs(p - g)),
        "sq_rel_2": np.mean(((p - g) / g) ** 2),
    }.items():
        assert found[name] == pytest.approx(value, rel=1e-6), name
    plain = strat.evaluate(predicted, truth, **words)
    assert plain["silog"] is None and plain["abs_rel"] == found["abs_rel"]
    with pytest.raises(TypeError, match='unknown argument "metric"; known: focal_px'):
        strat.evaluate(predicted, truth, metric=True, **words)


def test_disparity_becomes_depth_by_the_camera():
    predicted, truth = scene()
    width = truth.shape[1]
    pixels = 700.0 * 0.5 / predicted
    ways = {
        "disparity_px": pixels,
        "disparity_fraction": pixels / width,
        "inverse_depth_per_m": 1 / predicted,
    }
    depth = strat.evaluate(predicted, truth, protocol="eigen-80-nocrop", meaning="depth_m")
    for meaning, values in ways.items():
        found = strat.evaluate(values, truth, protocol="eigen-80-nocrop", meaning=meaning, **CAMERA)
        assert found["abs_rel"] == pytest.approx(depth["abs_rel"], rel=1e-5), meaning


def test_inverse_depth_of_no_scale_is_scaled_by_medians():
    predicted, truth = scene()
    two = [
        strat.evaluate(factor / predicted, truth, protocol="eigen-80-nocrop", meaning="inverse_depth", **CAMERA)
        for factor in (1.0, 7.0)
    ]
    assert two[0]["protocol"] == "eigen-80-nocrop-median"
    assert two[0]["rmse"] == pytest.approx(two[1]["rmse"], rel=1e-5)
    mask = (truth > 1e-3) & (truth < 80)
    depth = strat.evaluate(predicted, truth, protocol="eigen-80-nocrop-median", meaning="depth_m")
    assert depth["scale"] == pytest.approx(np.median(truth[mask]) / np.median(predicted[mask]), rel=1e-5)
    assert depth["shift"] == 0


def test_any_array_of_floats_will_do():
    predicted, truth = scene()
    predicted = predicted.astype(np.float16).astype(np.float32)
    score = lambda array: strat.evaluate(array, truth, protocol="eigen-80-nocrop", meaning="depth_m")
    expected = score(predicted)
    wide = np.repeat(np.repeat(predicted, 2, axis=0), 3, axis=1)

    class Tensor:
        def __init__(self, array):
            self.array = array

        def detach(self):
            return self

        def cpu(self):
            return self

    class WithArray(Tensor):
        def __array__(self, dtype=None, copy=None):
            return self.array

    class WithDlpack(Tensor):
        def __dlpack__(self, **words):
            return self.array.__dlpack__(**words)

        def __dlpack_device__(self):
            return self.array.__dlpack_device__()

    for array in (
        predicted.astype(np.float16),
        predicted.astype(np.float64),
        predicted.astype(">f4"),
        np.asfortranarray(predicted),
        wide[::2, ::3],
        predicted[::-1, ::-1][::-1, ::-1],
        WithArray(predicted),
        WithDlpack(predicted),
        predicted.tolist(),
    ):
        assert score(array) == expected


def test_a_map_of_any_size_is_resized_once_for_all_protocols():
    truth = np.zeros((100, 330), dtype=np.float32)
    truth[40:, :] = 20
    image = np.full((100, 330, 3), 90, dtype=np.uint8)
    words = {"meaning": "disparity_fraction", "focal_px": 200.0, "baseline_m": 0.5}
    both = strat.evaluate_all(disparity(image), truth, protocols=["eigen-80", "eigen-50"], **words)
    assert [score["protocol"] for score in both] == ["eigen-80", "eigen-50"]
    for score in both:
        alone = strat.evaluate(disparity(image), truth, protocol=score["protocol"], **words)
        assert alone == score


def test_groups_are_scored_apart():
    truth = np.full((375, 1242), 20, dtype=np.float32)
    labels = np.full(truth.shape, 7, dtype=np.int64)
    labels[:, 600:] = 26
    fraction = np.full((192, 640), 721.5377 * 0.54 / 20 / 1242 * 1.1, dtype=np.float32)
    words = {"meaning": "disparity_fraction", **CAMERA}
    scores = strat.evaluate_all(fraction, truth, protocols=["semantic"], labels=labels, **words)
    assert {score["group"] for score in scores} == {"flat", "vehicle"}
    with pytest.raises(ValueError, match="evaluate_all returns one score for each"):
        strat.evaluate(fraction, truth, protocol="semantic", labels=labels, **words)
    with pytest.raises(ValueError, match="needs an image of Cityscapes labels"):
        strat.evaluate_all(fraction, truth, protocols=["semantic"], **words)
    with pytest.raises(ValueError, match="the labels: .* not integers"):
        strat.evaluate_all(fraction, truth, protocols=["semantic"], labels=truth, **words)


def test_stereo_truth_is_disparity_or_the_depth_of_it():
    disparity_px = np.zeros((375, 1242), dtype=np.float32)
    disparity_px[100:, ::5] = np.round(np.linspace(5, 80, 275) * 256)[:, None] / 256
    depth = np.divide(721.5377 * 0.54, disparity_px, out=np.zeros_like(disparity_px), where=disparity_px > 0)
    fraction = np.full((192, 640), 0.03, dtype=np.float32)
    words = {"protocol": "kitti2015", "meaning": "disparity_fraction"}
    of_disparity = strat.evaluate(fraction, disparity_px, truth_meaning="disparity_px", **words)
    of_depth = strat.evaluate(fraction, depth, **words)
    assert of_disparity == of_depth and of_disparity["d1_all"] > 50
    with pytest.raises(ValueError, match="1242, 1241, 1238 and 1224 pixels wide, and this truth is 621 wide"):
        strat.evaluate(fraction, depth[:, ::2], **words)
    with pytest.raises(ValueError, match="only protocols of stereo 2015 compare with disparity"):
        strat.evaluate(fraction, depth, truth_meaning="disparity_px", meaning="disparity_fraction", **CAMERA)
    with pytest.raises(ValueError, match="evaluate under protocols of one kind"):
        strat.evaluate_all(fraction, depth, protocols=["kitti2015", "eigen-80"], meaning="disparity_fraction")


def refused(prediction=None, truth=None, **words):
    given, true = scene()
    words = {"protocol": "eigen-80-nocrop", "meaning": "depth_m"} | words
    with pytest.raises(ValueError) as raised:
        strat.evaluate(given if prediction is None else prediction, true if truth is None else truth, **words)
    return str(raised.value)


def test_what_cannot_be_scored_is_refused_in_sentences():
    predicted, truth = scene()
    assert "the prediction: its type is `int64`" in refused(predicted.astype(np.int64))
    assert "the prediction: its shape is [1, 20, 60]; it should have two dimensions" in refused(predicted[None])
    assert "without values" in refused(np.zeros((0, 5), dtype=np.float32))
    broken = predicted.copy()
    broken[3, 4] = np.nan
    assert refused(broken) == "the map is not a number at row 3, column 4"
    assert refused(np.full((20, 60), 1e39)) == "the map is not a number at row 0, column 0"
    assert "depth cannot be negative" in refused(-predicted)
    assert "are these pixels (`meaning: disparity_px`)" in refused(meaning="disparity_fraction", **CAMERA)
    assert "its rows and columns seem to be swapped" in refused(predicted.T)
    assert 'unknown protocol "eigen-81"' in refused(protocol="eigen-81")
    assert 'unknown meaning "metres"; known: disparity_fraction' in refused(meaning="metres")
    assert "give focal_px" in refused(1 / predicted, meaning="inverse_depth_per_m")
    assert "give both or neither" in refused(1 / predicted, meaning="inverse_depth_per_m", focal_px=700.0)
    no_focal = refused(1 / predicted, meaning="inverse_depth_per_m", focal_px=0.0, baseline_m=0.5)
    assert "the focal length in pixels of the image is 0" in no_focal
    assert "mirrored images" in refused(protocol="eigen-80-pp")
    assert "`sigmoid` makes inverse depth" in refused(sigmoid=(0.1, 100.0))
    assert "the map is dead" in refused(np.zeros_like(predicted))
    assert "the truth: its type is `uint16`" in refused(truth=truth.astype(np.uint16))
    assert "the true depth at row 0, column 0 is -1" in refused(truth=np.full((20, 60), -1.0))
    assert "no pixel of this image is left" in refused(truth=np.zeros((20, 60)))
    assert "write [\"eigen-80\"]" in refused_all(protocols="eigen-80")


def refused_all(**words):
    with pytest.raises(ValueError) as raised:
        strat.evaluate_all(*scene(), meaning="depth_m", **words)
    return str(raised.value)


def test_threads_evaluate_side_by_side():
    predicted, truth = scene(200, 600)
    words = {"protocol": "eigen-80-nocrop", "meaning": "depth_m"}
    expected = strat.evaluate(predicted, truth, **words)
    found = []
    threads = [
        threading.Thread(target=lambda: found.append(strat.evaluate(predicted, truth, **words))) for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [expected] * 8


def test_protocols_are_described():
    assert "eigen-80" in strat.protocols()
    assert "digest" in strat.describe("eigen-80-median")
