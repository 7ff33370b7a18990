"""Models without a scale: alignment, the crop of KITTI's benchmark, further metrics (PROTOCOL 10).

python3 tests/oracle/alignment.py    checks the fits against numpy's solver and maps of known scale
"""

import numpy as np

import evaluation
import geometry

INVERSE_DEPTH_FLOOR = 1e-3  # per metre
BENCHMARK_ROWS, BENCHMARK_COLUMNS = 352, 1216


def line(x, y):
    """(s, t) of the least squares y = s x + t; a constant x has s = 0."""
    dx, dy = x - x.mean(), y - y.mean()
    spread = dx @ dx
    slope = dx @ dy / spread if spread > 0 else 0.0
    return slope, y.mean() - slope * x.mean()


def align(kind, predicted, true):
    """Depth in metres before clipping, and (scale, shift). Arrays of the scored pixels, float64."""
    if kind == "none":
        return predicted, (1.0, 0.0)
    if kind == "median":
        scale = np.median(true) / np.median(predicted)
        return scale * predicted, (scale, 0.0)
    fit, meaning = kind.split("-")
    target, used = (true, predicted == predicted) if meaning == "depth" else (1 / true, predicted > 0)
    x, y = predicted[used], target[used]
    scale, shift = line(x, y) if fit == "affine" else (x @ y / (x @ x), 0.0)
    moved = scale * predicted + shift
    return (moved if meaning == "depth" else 1 / np.maximum(moved, INVERSE_DEPTH_FLOOR)), (scale, shift)


def benchmark_crop(height, width):
    """Slices of rows and columns."""
    top, left = height - BENCHMARK_ROWS, (width - BENCHMARK_COLUMNS) // 2
    return slice(top, height), slice(left, left + BENCHMARK_COLUMNS)


def further_metrics(true, predicted):
    """silog, log10, irmse (per km), mae (m), and the squared relative error over the squared truth."""
    logarithms = np.log(predicted / true)
    return [
        float(100 * np.sqrt(max(np.mean(logarithms**2) - np.mean(logarithms) ** 2, 0))),
        float(np.mean(np.abs(logarithms)) / np.log(10)),
        float(np.sqrt(np.mean((1000 / predicted - 1000 / true) ** 2))),
        float(np.mean(np.abs(true - predicted))),
        float(np.mean((true - predicted) ** 2 / true**2)),
    ]


def evaluate(kind, true, predicted, crop, near, far, cut=False):
    """Seven metrics, five further ones, scale and shift; `cut` takes the benchmark's crop of both first."""
    if cut:
        at = benchmark_crop(*true.shape)
        true, predicted = true[at], predicted[at]
    at = (true > near) & (true < far) & geometry.crop(crop, *true.shape)
    true = true[at].astype(np.float64)
    depth, fit = align(kind, predicted[at].astype(np.float64), true)
    depth = np.clip(depth, near, far)
    return [*evaluation.metrics(true, depth), *further_metrics(true, depth), *map(float, fit)]


def check():
    random = np.random.default_rng(0)
    true = random.uniform(2, 80, 5000)
    noisy = 3 + 0.02 * true + random.normal(0, 0.01, true.size)
    solved = np.linalg.lstsq(np.stack([noisy, np.ones_like(noisy)], axis=1), true, rcond=None)[0]
    assert np.allclose(line(noisy, true), solved, rtol=1e-9)
    # A map that differs from the truth by scale and shift alone comes back exactly.
    for kind, predicted, fit in [
        ("affine-depth", (true - 7) / 3, (3, 7)),
        ("scale-depth", true / 3, (3, 0)),
        ("median", true / 3, (3, 0)),
        ("affine-disparity", (1 / true - 0.004) / 0.02, (0.02, 0.004)),
        ("scale-disparity", 50 / true, (0.02, 0)),
    ]:
        depth, found = align(kind, predicted, true)
        if kind.endswith("disparity"):  # values at or below zero take no part in the fit
            depth, expected = depth[predicted > 0], true[predicted > 0]
        else:
            expected = true
        assert np.allclose(depth, expected) and np.allclose(found, fit), kind
    depth, (scale, shift) = align("affine-depth", np.full_like(true, 5), true)
    assert scale == 0 and np.allclose(depth, true.mean()) and np.isclose(shift, true.mean())
    plane = np.zeros((375, 1242))
    plane[23:375, 13:1229] = 1
    assert plane[benchmark_crop(375, 1242)].sum() == plane.sum() == 352 * 1216
    silog, log10, irmse, mae, sq_rel_2 = further_metrics(true, 1.1 * true)
    assert silog < 1e-5 and np.isclose(log10, np.log10(1.1)) and np.isclose(mae, 0.1 * true.mean())
    assert np.isclose(sq_rel_2, 0.01) and np.isclose(irmse, 1000 / 11 * np.sqrt(np.mean(true**-2.0)))


if __name__ == "__main__":
    check()
    print("the fits are right")
