"""Metrics and protocols (PROTOCOL 3.1 to 3.9, 1.3, 1.4)."""

import numpy as np

import geometry

FLOOR = 1e-4  # of the image width (D8)
GROUPS = {
    "flat": range(7, 11),
    "human": range(24, 26),
    "vehicle": range(26, 34),
    "construction": range(11, 17),
    "object": range(17, 21),
}
DISTANCES_M = (0, 5, 10, 15, 20, 30, 40, 50, 60, 80, np.inf)  # upper bounds included


def metrics(true, predicted):
    """Abs Rel, Sq Rel, RMSE, RMSE log and the three shares below 1.25^k."""
    error = true - predicted
    logarithms = np.log(true / predicted)
    worst = np.maximum(true / predicted, predicted / true)
    return [
        float(np.mean(np.abs(error) / true)),
        float(np.mean(error**2 / true)),
        float(np.sqrt(np.mean(error**2))),
        float(np.sqrt(np.mean(logarithms**2))),
        *(float(np.mean(worst < 1.25**k)) for k in (1, 2, 3)),
    ]


def d1_all(true_px, predicted_px):
    """Percentage of pixels that are 3 px or more and 5 % or more away."""
    error = np.abs(predicted_px - true_px)
    return float(100 * np.mean((error >= 3) & (error >= 0.05 * true_px)))


def _depth(fraction, shape, focal_px, baseline_m, floor=FLOOR):
    """Depth at the truth's size, and the disparity in pixels."""
    height, width = shape
    fraction = np.maximum(geometry.bilinear(fraction, width, height), np.float32(floor))
    pixels = fraction.astype(np.float64) * width
    with np.errstate(divide="ignore"):
        return focal_px * baseline_m / pixels, pixels


def stereo_pixels(true_px, fraction, camera=None):
    """Where truth is, true and clipped predicted depth, true and predicted disparity: the KITTI split.

    `camera` is (focal length, baseline); the nominal one of the width otherwise.
    """
    focal_px, baseline_m = camera or (
        geometry.NOMINAL_FOCAL_PX[true_px.shape[1]],
        geometry.NOMINAL_BASELINE_M,
    )
    depth, pixels = _depth(fraction, true_px.shape, focal_px, baseline_m)
    at = true_px > 0
    true = focal_px * baseline_m / np.where(at, true_px, 1).astype(np.float64)
    return at, true, np.clip(depth, 1e-3, 80), true_px.astype(np.float64), pixels


def kitti2015(true_px, fraction, camera=None):
    """Seven metrics and D1-all."""
    at, true, depth, true_px, pixels = stereo_pixels(true_px, fraction, camera)
    return [*metrics(true[at], depth[at]), d1_all(true_px[at], pixels[at])]


def by_group(measured, labels):
    """(name, its pixels) of each group of Table 3.2 that the image has."""
    for name, ids in GROUPS.items():
        inside = measured & np.isin(labels, list(ids))
        if inside.any():
            yield name, inside


def eigen_pixels(true, fraction, camera, near=1e-3, far=80.0, crop="garg", median=False, floor=FLOOR):
    """Scored pixels, true and clipped predicted depth under a protocol of the Eigen split."""
    depth, _ = _depth(fraction, true.shape, *camera, floor)
    at = (true > near) & (true < far) & geometry.crop(crop, *true.shape)
    true = true.astype(np.float64)
    if median:
        depth = depth * (np.median(true[at]) / np.median(depth[at]))
    return at, true, np.clip(depth, near, far)


def eigen(*arguments, **rules):
    """Seven metrics; arguments as for `eigen_pixels`."""
    at, true, depth = eigen_pixels(*arguments, **rules)
    return metrics(true[at], depth[at])


def by_distance(measured, true):
    """(name, its pixels) of each range of true depth that the image has."""
    for above, end in zip(DISTANCES_M, DISTANCES_M[1:]):
        inside = measured & (true > above) & (true <= end)
        if inside.any():
            yield f"{above}-{end}m" if end < np.inf else f"over-{above}m", inside


def make3d(true, depth):
    """Abs Rel, Sq Rel, RMSE and RMSE of log10 under criterion C1; `depth` at network size."""
    rows = np.arange(true.shape[0]) * depth.shape[0] // true.shape[0]
    columns = np.arange(true.shape[1]) * depth.shape[1] // true.shape[1]
    at = (true > 0) & (true < 70)
    true, depth = true[at], depth[np.ix_(rows, columns)][at]
    depth = np.minimum(depth * np.median(true) / np.median(depth), 70)
    error = true - depth
    return [
        float(np.mean(np.abs(error) / true)),
        float(np.mean(error**2 / true)),
        float(np.sqrt(np.mean(error**2))),
        float(np.sqrt(np.mean(np.log10(true / depth) ** 2))),
    ]
