"""The console script ``strat``: the commands ``prep`` and ``bench`` without Rust."""

from __future__ import annotations

import signal
import sys

from . import _strat

_HELP = """\
Prepares data sets and evaluates depth models.

Usage: strat prep ...     prepare KITTI, Eigen, own pairs; `strat prep --help`
       strat bench ...    evaluate models, compare, draw, time; `strat bench --help`
       strat --version

Exit codes: 0 done, 1 failed or incomplete, 2 wrong usage.
"""
_NO_TRAIN = (
    "error: `train` is not part of this package, which has no training code; build the command from the "
    "repository with `cargo install --locked --path train`, or train in Python on strat.PreparedSet\n"
)

# With the package of this process and not with a folder of its name where the command was typed.
_AGAIN = """\
import sys
if sys.path[:1] == [""]:
    del sys.path[0]
from strat._commands import main
sys.exit(main())
"""


def main(arguments: list[str] | None = None) -> int:
    """Runs the command that the arguments name and returns its exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    match words:
        case ["--help" | "-h" | "help", *_]:
            sys.stdout.write(_HELP)
            return 0
        case ["--version" | "-V", *_]:
            sys.stdout.write(f"strat {_strat.__version__}\n")
            return 0
        case ["prep" | "bench" as command, *rest]:
            # Python only takes a note of Ctrl-C until Rust comes back; the commands end at once.
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            return _strat.run_command([sys.executable, "-c", _AGAIN], command, rest)
        case ["train", *_]:
            sys.stderr.write(_NO_TRAIN)
            return 2
        case []:
            sys.stderr.write(_HELP)
            return 2
        case [other, *_]:
            sys.stderr.write(f"error: unknown command `{other}`; this package has prep and bench\n")
            return 2
    return 2
