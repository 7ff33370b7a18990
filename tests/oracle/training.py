"""Sampler, losses, pyramid and schedules of the training (PROTOCOL 4.3, 4.4, 4.6).

Images are [rows, columns, channels] in 0..1, disparities [rows, columns] as fractions of the width.
"""

import numpy as np


def sample(image, offset):
    """image(x + offset * width) along each row, black one pixel outside and beyond."""
    rows, columns, _ = image.shape
    framed = np.pad(image, ((0, 0), (1, 1), (0, 0)))
    position = np.clip(np.arange(columns) + columns * offset, -1, columns) + 1
    left = np.minimum(np.floor(position).astype(int), columns)
    weight = (position - left)[:, :, None]
    row = np.arange(rows)[:, None]
    return framed[row, left] * (1 - weight) + framed[row, left + 1] * weight


def dssim(a, b):
    """(1 - SSIM) / 2 in 0..1 for each 3x3 window that lies inside, per channel."""

    def mean(values):
        windows = np.lib.stride_tricks.sliding_window_view(values, (3, 3), axis=(0, 1))
        return windows.mean(axis=(-2, -1))

    mean_a, mean_b = mean(a), mean(b)
    variances = mean(a * a) - mean_a**2 + mean(b * b) - mean_b**2
    covariance = mean(a * b) - mean_a * mean_b
    c1, c2 = 0.01**2, 0.03**2
    similar = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    similar /= (mean_a**2 + mean_b**2 + c1) * (variances + c2)
    return np.clip((1 - similar) / 2, 0, 1)


def level(image, power):
    """Level `power` of the pyramid: means over blocks of 2^power pixels."""
    size = 2**power
    rows, columns, channels = image.shape
    blocks = image.reshape(rows // size, size, columns // size, size, channels)
    return blocks.mean(axis=(1, 3))


def smoothness(disparity, image):
    """Mean horizontal change of the disparity, less where the image changes."""
    change = np.abs(np.diff(disparity, axis=1))
    return float(np.mean(change * np.exp(-np.abs(np.diff(image, axis=1)).mean(axis=2))))


def terms(left, right, disparities):
    """SSIM, L1, left-right and smoothness of the left and of the right view, summed over four levels.

    `disparities` are (left, right) for each level.
    """
    sums = {}
    for power, (d_left, d_right) in enumerate(disparities):
        real = {"left": level(left, power), "right": level(right, power)}
        own = {"left": d_left, "right": d_right}
        for view, other, sign in (("left", "right", -1), ("right", "left", 1)):
            made = sample(real[other], sign * own[view])
            carried = sample(own[other][:, :, None], sign * own[view])[:, :, 0]
            for name, value in (
                ("ssim", dssim(made, real[view]).mean()),
                ("l1", np.abs(made - real[view]).mean()),
                ("left_right", np.abs(carried - own[view]).mean()),
                ("smoothness", smoothness(own[view], real[view]) / 2**power),
            ):
                sums[name, view] = sums.get((name, view), 0.0) + float(value)
    return sums


def total(sums, **weights):
    """Weighted sum of the terms of both views."""
    return sum(weights[name] * value for (name, _), value in sums.items())


def baseline(epoch, epochs=50, start=0.1):
    """Fraction of the baseline in an epoch that counts from 0."""
    return start + (1 - start) * epoch / epochs


def learning_rate(position, epochs=50, first=1e-4):
    """Constant for half of the epochs, then linear to zero; `position` may lie within an epoch."""
    return first * min(1.0, 2 * (1 - position / epochs))
