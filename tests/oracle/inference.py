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


def cluster_mean(values, clusters):
    """Mean over images, its cluster-robust standard error, and the number of clusters."""
    values, clusters = np.asarray(values, float), np.asarray(clusters)
    names = np.unique(clusters)
    mean = values.mean()
    residuals = np.array([(values[clusters == name] - mean).sum() for name in names])
    k = names.size
    return float(mean), math.sqrt(k / (k - 1) * residuals @ residuals) / values.size, k
