"""Scripts that a user runs from a checkout: train, ppo, policy_search, evaluate, benchmark, tune, headroom, demo."""

import os
import sys
from importlib.util import find_spec

from agents.stopping import guard_imports

guard_imports()

# Before numpy is imported. Matrices have a few rows here, for which BLAS's threads only wait for each other: beside
# other work a gain of the LQR takes four times as long with them.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_NEEDED = (
    *("gymnasium", "matplotlib", "numba", "numpy", "rich", "scipy", "stable_baselines3", "tensorboard", "torch"),
    *("tqdm", "tyro"),
)
_missing = [name for name in _NEEDED if find_spec(name) is None]
if _missing:
    print(
        f"error: this Python lacks {', '.join(_missing)}. Use the one that `make demo` set up (.venv/bin/python, or "
        'source .venv/bin/activate), or pip install -c constraints.txt -e ".[agents]"',
        file=sys.stderr,
    )
    sys.exit(2)  # as for every mistake of a user
