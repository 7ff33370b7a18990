"""Rows, and what is a function of them alone."""

from __future__ import annotations

import json
import os
from typing import Any

from . import _strat

Path = str | os.PathLike[str]


class Records(list[dict[str, Any]]):
    """Dicts of the same keys."""

    def __init__(self, records: list[dict[str, Any]], text: str = "") -> None:
        super().__init__(records)
        #: The same for people, where there is such a form.
        self.text = text

    def to_pandas(self) -> Any:
        """A ``pandas.DataFrame``; needs pandas."""
        import pandas

        return pandas.DataFrame(list(self))


class Rows:
    """Lines of ``rows.csv``: one per model, protocol, image and group."""

    def __init__(self, rows: _strat.Rows) -> None:
        self._rows = rows

    def __len__(self) -> int:
        return len(self._rows)

    def columns(self) -> dict[str, list[Any]]:
        """All rows by column: text, numbers, and None where a cell is empty."""
        return self._rows.columns()

    def records(self) -> Records:
        """All rows, a dict each."""
        columns = self.columns()
        return Records([dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)])

    def to_pandas(self) -> Any:
        """A ``pandas.DataFrame``; needs pandas."""
        import pandas

        return pandas.DataFrame(self.columns())

    def write(self, path: Path) -> None:
        """Writes them as ``rows.csv``; the file appears whole or not at all.

        :raises OSError: it cannot be written.
        """
        self._rows.write(os.fspath(path))


def read_rows(*paths: Path) -> Rows:
    """Reads rows files as one; the ``run.yaml`` beside the first says how many images there should be.

    :raises OSError: a file cannot be read.
    :raises ValueError: a file is no rows file, or two contradict each other.
    """
    if not paths:
        raise ValueError("give at least one rows file")
    return Rows(_strat.read_rows([os.fspath(path) for path in paths]))


def _merged(rows: tuple[Rows, ...]) -> _strat.Rows:
    match rows:
        case ():
            raise ValueError("give rows")
        case (only,):
            return only._rows
        case _:
            return _strat.merge_rows([one._rows for one in rows])


def compare(
    *rows: Rows,
    protocol: str | None = None,
    model_a: str | None = None,
    model_b: str | None = None,
    metrics: bool = False,
    draws: int = 10_000,
    seed: int = 0,
) -> Records:
    """Tests the differences between models over the images both have, as ``bench compare`` does.

    Each record has the means, ``difference`` (second minus first), its 95 % ``interval`` (``low``, ``high``),
    ``p_permutation``, ``p_wilcoxon`` and ``p_holm``; ``text`` is the same for people.

    :param metrics: test the further metrics as well, of rows that were measured with them.
    :param draws: sign patterns that are drawn where there are too many to count.
    :raises ValueError: fewer than two models, or rows of different protocols or data.
    """
    tests, text = _merged(rows).compare(protocol, model_a, model_b, draws, seed, metrics)
    return Records(json.loads(tests), text)


def table(*rows: Rows, format: str = "text") -> str:
    """The thesis' tables that the rows fill, as ``text``, ``markdown``, ``latex`` or ``csv``.

    :raises ValueError: no table is about their protocols, or they do not belong together.
    """
    return _merged(rows).table(format)


def leaderboard(*rows: Rows) -> Records:
    """The lines of ``leaderboard.csv``: measured ones, and published ones of the same protocols.

    :raises ValueError: rows that do not belong together.
    """
    return Records(_merged(rows).leaderboard())
