"""Trusted numbers for monocular depth estimation, from arrays in memory.

Three things to do with it:

* :func:`evaluate` scores one predicted map against one ground truth;
* :class:`Run` scores the test images of a prepared set while a network predicts them, and writes the same
  files as the command ``bench``;
* :class:`PreparedSet` reads a prepared set as data for training.

Rows come back by :func:`read_rows`; :func:`compare`, :func:`table` and :func:`leaderboard` are functions of
them. The commands are ``strat prep ...`` and ``strat bench ...``.

Errors are ``ValueError`` with a sentence that says what is wrong with what was given, and ``OSError`` where a
file or folder cannot be used.
"""

from ._evaluate import describe, evaluate, evaluate_all, protocols
from ._rows import Records, Rows, compare, leaderboard, read_rows, table
from ._run import Mean, Run, Sample
from ._set import PreparedSet, Samples
from ._strat import __version__

__all__ = [
    "Mean",
    "PreparedSet",
    "Records",
    "Rows",
    "Run",
    "Sample",
    "Samples",
    "__version__",
    "compare",
    "describe",
    "evaluate",
    "evaluate_all",
    "leaderboard",
    "protocols",
    "read_rows",
    "table",
]
