"""A prepared set measured while a network predicts its images."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import _arrays, _strat
from ._evaluate import Meaning
from ._rows import Rows


class Sample(NamedTuple):
    """A test image."""

    #: Such as ``2011_09_26_drive_0002/0000000069``.
    id: str
    #: uint8, rows, columns and R, G, B: the untouched left image.
    image: NDArray[np.uint8]
    #: Focal length in pixels of this image.
    focal_px: float
    #: Stereo baseline in metres.
    baseline_m: float


class Mean(NamedTuple):
    """A mean over images."""

    value: float
    #: Bounds of the 95 % interval; None with too few recordings.
    low: float | None
    high: float | None
    #: How many.
    images: int


class Run:
    """One model over the test images of a prepared set.

    Iterating gives each test image as a :class:`Sample`, in the order of the set, read ahead by threads.
    :meth:`add` takes the maps in any order, from any number of threads. Rows, tables and leaderboard are
    those that ``bench --predictions`` makes of a folder into which ``numpy.save`` has written the same maps
    as float32, byte for byte.

    :param data: the folder that ``prep`` has written.
    :param protocols: names or YAML files; without them those of the set's own tables.
    :param model: name in tables. ``NAME@SEED`` is one seed of a method.
    :param meaning: what the numbers of the maps are, with ``sigmoid``, ``scale`` and ``stretched`` as for
        :func:`strat.evaluate`.
    :param metrics: measure the further metrics as well (``silog``, ``log10``, ``irmse``, ``mae``, ``sq_rel_2``), as
        ``bench --metrics`` does.
    :param threads: threads that read images ahead.
    :raises OSError: no prepared set is there.
    :raises ValueError: the set cannot serve a protocol, or there is no such word.
    """

    def __init__(
        self,
        data: str | os.PathLike[str],
        protocols: Sequence[str] | None = None,
        *,
        model: str,
        meaning: str,
        sigmoid: tuple[float, float] | None = None,
        scale: float | None = None,
        stretched: bool = False,
        metrics: bool = False,
        threads: int | None = None,
    ) -> None:
        if isinstance(protocols, str):
            raise ValueError(f'protocols are a list of names; write ["{protocols}"]')
        self._threads = threads if threads is not None else min(4, os.cpu_count() or 1)
        if self._threads < 1:
            raise ValueError("at least one thread is needed to read images")
        wanted = None if protocols is None else list(protocols)
        numbers = Meaning(meaning, sigmoid, scale, stretched)
        self._run = _strat.Run(os.fspath(data), model, wanted, numbers, metrics)

    def __len__(self) -> int:
        """How many test images there are."""
        return len(self._run.ids())

    def __iter__(self) -> Iterator[Sample]:
        images = self._run.images(self._threads)
        while (item := images.next()) is not None:
            yield Sample(**item)

    @property
    def ids(self) -> list[str]:
        """Ids of the test images, in the order of the set."""
        return self._run.ids()

    @property
    def protocols(self) -> list[str]:
        """Names of the protocols; with ``-median`` for maps without a scale of their own."""
        return self._run.protocols()

    def add(self, image: str, prediction: Any) -> None:
        """Measures the map of one image.

        With the last of the first eight images of the set it warns of what their maps look like and are not said
        to be: near and far exchanged, a factor, a scale of their own, a map that is turned, a sky that is nearest.

        :param image: its id.
        :param prediction: as for :func:`strat.evaluate`.
        :raises ValueError: there is no such image, it has a map already, or the map cannot be scored; the
            run is then as it was.
        """
        try:
            values = _arrays.floats(prediction)
        except ValueError as error:
            raise ValueError(f"image {image}: {error}") from None
        for text in self._run.add(image, values):
            warnings.warn(text, stacklevel=2)

    @property
    def missing(self) -> list[str]:
        """Ids of the images without a map, in the order of the set."""
        return self._run.missing()

    @property
    def failures(self) -> dict[str, str]:
        """Images that lack rows, with the reason."""
        return dict(self._run.failures())

    @property
    def warnings(self) -> list[str]:
        """Reasons to doubt the numbers, such as depth in the reverse order."""
        return self._run.warnings()

    def rows(self) -> Rows:
        """The rows so far, in the order protocol, image, group."""
        return Rows(self._run.rows())

    def table(self) -> str:
        """What ``bench`` prints: the set's tables, then numbers under other protocols."""
        return self._run.table()

    def summary(self) -> dict[str, dict[str, Any]]:
        """Means over the images so far: ``summary()["eigen-80"]["abs_rel"]`` is a :class:`Mean`.

        Under a protocol with groups these are one level deeper: ``summary()["semantic"]["vehicle"]["rmse"]``.
        """
        found: dict[str, dict[str, Any]] = {}
        for protocol, group, name, (value, bounds, images) in self._run.summary():
            means = found.setdefault(protocol, {})
            if group is not None:
                means = means.setdefault(group, {})
            low, high = bounds if bounds is not None else (None, None)
            means[name] = Mean(value, low, high, images)
        return found

    def write(self, out: str | os.PathLike[str], *, incomplete: bool = False, force: bool = False) -> None:
        """Writes ``rows.csv``, ``leaderboard.csv``, the tables, ``run.yaml`` and, with failures, ``failures.csv``.

        Reasons to doubt the numbers are also issued as warnings.

        :param out: a folder, made if it is not there. Results of another run in it are left alone.
        :param incomplete: write although images are missing; every table then says so.
        :param force: replace results of another run (``--force`` of the command).
        :raises ValueError: images lack rows.
        :raises OSError: the folder cannot be written to, or has results of another run.
        """
        for text in self._run.write(os.fspath(out), incomplete, force):
            warnings.warn(text, stacklevel=2)
