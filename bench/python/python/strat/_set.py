"""A prepared set as data for training and validation."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

from . import _strat


class Samples:
    """The samples of one role, by index. Picklable, so a ``DataLoader`` with workers takes it as it is.

    Each sample is a dict of ``id``, ``drive`` (None where the id has none), ``width`` and ``height`` (pixels
    of the untouched image), ``focal_px`` (pixels of an image that wide), ``baseline_m`` (metres), ``left`` and,
    of pairs, ``right`` (uint8, rows, columns and R, G, B, at network size). Where the set has them there are
    ``image`` (the untouched left image), ``depth_velodyne``, ``depth_camera``, ``depth_noc``, ``depth_occ``,
    ``depth_annotated`` and ``depth_laser`` (float32, metres, 0 is none), ``semantic`` (uint8) and ``instance``
    (uint16).

    :raises OSError: a file of a sample cannot be read.
    :raises ValueError: a file is not the one that was prepared.
    """

    def __init__(
        self, root: str, role: str, opened: _strat.Set | None = None, names: tuple[str, ...] | None = None
    ) -> None:
        self._root = root
        self._role = role
        self._set = _strat.Set(root) if opened is None else opened
        self._ids = self._set.ids(role)
        self._names = names

    def __reduce__(self) -> tuple[Any, ...]:
        return (Samples, (self._root, self._role, None, self._names))

    def only(self, *names: str) -> Samples:
        """The same samples with these keys alone, e.g. ``train.only("left", "right")``; no other file is read.

        Untouched images and their depth differ in size from drive to drive, so a ``DataLoader`` makes
        batches of what has the network's size only.

        :raises ValueError: when a sample is taken that has no such key.
        """
        return Samples(self._root, self._role, self._set, names)

    @property
    def ids(self) -> list[str]:
        """Ids in the order of the set."""
        return list(self._ids)

    def __len__(self) -> int:
        return len(self._ids)

    def __getitem__(self, index: int) -> dict[str, Any]:
        at = range(len(self._ids))[index]
        return self._set.sample(self._role, at, None if self._names is None else list(self._names))

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (self[index] for index in range(len(self)))


class PreparedSet:
    """A folder that ``prep`` has written.

    :param root: the folder.
    :raises OSError: it is no finished prepared set.
    """

    def __init__(self, root: str | os.PathLike[str]) -> None:
        self._root = os.fspath(root)
        opened = _strat.Set(self._root)
        #: ``kitti``, ``eigen``, ``pairs``, ``make3d`` or ``cityscapes``.
        self.content: str
        #: ``kitti`` for recorded images, ``rendered``, or the name of a collection.
        self.source: str
        #: BLAKE3 of the tables, which name every file with its own.
        self.data_digest: str
        self.content, self.source, self.data_digest = opened.about()
        #: What a network learns from.
        self.train = Samples(self._root, "train", opened)
        #: What is watched while it learns.
        self.val = Samples(self._root, "val", opened)
        #: What only the final evaluation looks at.
        self.test = Samples(self._root, "test", opened)

    def __reduce__(self) -> tuple[Any, ...]:
        return (PreparedSet, (self._root,))
