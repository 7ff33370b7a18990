"""``python -m strat`` is the console script."""

import sys

from ._commands import main

sys.exit(main())
