"""Intervals by drive and paired tests (PROTOCOL 11)."""

import itertools
import math

import numpy as np


def sign_flips(differences):
    """Two-sided p of the mean when every pattern of signs is as likely; counted, not drawn."""
    differences = np.asarray(differences)
    reached = abs(differences.sum())
    signs = np.array(list(itertools.product((-1, 1), repeat=differences.size)))
    return float(np.mean(np.abs(signs @ differences) >= reached * (1 - 1e-12)))


def _ranks(sizes):
    """Ranks from 1, equal sizes sharing their mean."""
    return np.array([(np.sum(sizes < s) + 1 + np.sum(sizes <= s)) / 2 for s in sizes])


def wilcoxon_exact(differences):
    """Two-sided p of the signed-rank sum by counting; without ties and zeros."""
    differences = np.asarray(differences)
    positive = _ranks(np.abs(differences))[differences > 0].sum()
    counts = np.array([1.0])
    for rank in range(1, differences.size + 1):
        counts = np.pad(counts, (0, rank)) + np.pad(counts, (rank, 0))
    at = int(positive)
    tail = min(counts[: at + 1].sum(), counts[at:].sum())
    return float(min(1.0, 2 * tail / counts.sum()))


def wilcoxon_normal(differences):
    """Two-sided p by the normal approximation; zeros left out, variance corrected for ties."""
    differences = np.asarray(differences)
    differences = differences[differences != 0]
    sizes = np.abs(differences)
    n = differences.size
    _, ties = np.unique(sizes, return_counts=True)
    variance = n * (n + 1) * (2 * n + 1) / 24 - np.sum(ties.astype(float) ** 3 - ties) / 48
    z = (_ranks(sizes)[differences > 0].sum() - n * (n + 1) / 4) / math.sqrt(variance)
    return math.erfc(abs(z) / math.sqrt(2))


def student_t(degrees, level=0.95):
    """The bound that Student's t stays within with probability `level`, from its density."""
    scale = math.exp(math.lgamma((degrees + 1) / 2) - math.lgamma(degrees / 2)) / math.sqrt(degrees * math.pi)
    # t = tan(angle): the tails are as near as the middle.
    angle = np.linspace(0, np.pi / 2, 2_000_001)[:-1]
    density = scale * (1 + np.tan(angle) ** 2 / degrees) ** (-(degrees + 1) / 2) / np.cos(angle) ** 2
    inside = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(angle))])
    return math.tan(np.interp(level / 2, inside, angle))


def degrees_of_freedom(counts):
    """Bell and McCaffrey's for the jackknife's variance of a mean over clusters of these sizes.

    The variance is a sum of squares of linear forms of independent images, one form a cluster: the
    residuals of the cluster, each over one minus the cluster's share.
    """
    counts = np.asarray(counts, float)
    total = counts.sum()
    # Forms as columns, rows standing for all images of a cluster at once.
    forms = (np.eye(counts.size) - counts / total) / (1 - counts / total)
    products = forms.T @ np.diag(counts) @ forms
    return float(np.trace(products) ** 2 / np.sum(products**2))


def interval(sums, counts, kind):
    """95 % interval of the ratio of the totals over clusters; `kind` is any, positive or fraction."""
    sums, counts = np.asarray(sums, float), np.asarray(counts, float)
    ratio = sums.sum() / counts.sum()
    without = (sums.sum() - sums) / (counts.sum() - counts)
    error = math.sqrt((sums.size - 1) / sums.size * np.sum((without - ratio) ** 2))
    half = student_t(degrees_of_freedom(counts)) * error
    if half == 0 or (kind == "fraction" and not 0 < ratio < 1):
        return ratio, ratio
    if kind == "any":
        return ratio - half, ratio + half
    if kind == "positive":
        return ratio * math.exp(-half / ratio), ratio * math.exp(half / ratio)
    logit, step = math.log(ratio / (1 - ratio)), half / (ratio * (1 - ratio))
    return 1 / (1 + math.exp(step - logit)), 1 / (1 + math.exp(-step - logit))


def study(first, second, counts):
    """Difference of two variants, arrays of seeds x drives with sums over images; PROTOCOL 11.1.

    Returns difference, standard error, degrees of freedom, interval, p, and which shares of the variance are
    those of seeds and of drives alone. Every jackknife is done by leaving out.
    """
    counts = np.asarray(counts, float)
    drives = counts.size

    def mean_without(sums, drive):
        kept = np.arange(drives) != drive
        return sums[..., kept].sum(-1) / counts[kept].sum()

    def jackknife(sums):
        """Variance over drives of each series of sums."""
        left = np.stack([mean_without(sums, drive) for drive in range(drives)])
        return (drives - 1) / drives * ((left - sums.sum(-1) / counts.sum()) ** 2).sum(0)

    free = degrees_of_freedom(counts)
    first, second = np.asarray(first, float), np.asarray(second, float)
    apart = second.mean(0) - first.mean(0)
    of_drives = jackknife(apart)
    of_seeds, on_both, weights = 0.0, 0.0, [(of_drives, free)]
    for runs in (first, second):
        seeds = len(runs)
        spread = np.var(runs.sum(1) / counts.sum(), ddof=1) / seeds
        single = jackknife(runs - runs.mean(0)).sum() / (seeds - 1) / seeds
        on_both += single
        if spread > single:
            of_seeds += spread - single
            weights += [(spread, seeds - 1), (single, (seeds - 1) * free)]
    variance = of_seeds + of_drives
    fewest = min(len(first) - 1, len(second) - 1, free)
    degrees = max(variance**2 / sum(part**2 / degrees for part, degrees in weights), fewest)
    difference, error = apart.sum() / counts.sum(), math.sqrt(variance)
    half = student_t(degrees) * error
    alone = [of_seeds / variance, max(of_drives - on_both, 0) / variance]
    interval = [difference - half, difference + half]
    return [difference, error, degrees, interval, outside_t(abs(difference) / error, degrees), alone]


def outside_t(bound, degrees):
    """Probability that Student's t is larger in size, from its density."""
    scale = math.exp(math.lgamma((degrees + 1) / 2) - math.lgamma(degrees / 2)) / math.sqrt(degrees * math.pi)
    angle = np.linspace(0, math.atan(bound), 1_000_001)
    density = scale * (1 + np.tan(angle) ** 2 / degrees) ** (-(degrees + 1) / 2) / np.cos(angle) ** 2
    return 1 - 2 * float(np.sum((density[1:] + density[:-1]) / 2 * np.diff(angle)))
