"""``python -m bicycle_env`` is the command ``bicycle-env``."""

import sys

from bicycle_env.cli import main

sys.exit(main())
