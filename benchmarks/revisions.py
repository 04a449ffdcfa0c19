"""Speed of this working tree over the speed of another revision, both in one run: every row of the benchmarks.

    python benchmarks/revisions.py 7cbf88c            # a revision of the repository, or the folder of a checkout
    python benchmarks/revisions.py 7cbf88c --only tanh --rounds 15

Each round has two new processes, which take turns: one pair's ratio may be some percent off for as long as both live,
so that its turns agree and still mislead; why is not known. Prints the median of the rounds' ratios, an interval that
holds the true median with at least 95 % (order statistics), and exits 1 if a median is below `--must`. Processor time;
two threads: wall time.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from bicycle_env import provenance
from bicycle_env.files import write_json

ROOT = Path(__file__).resolve().parents[1]
STAB, LANE_CHANGE = "BicycleStab-v0", "BicycleLaneChange-v0"
TIRES = ("linear", "tanh", "fiala", "magic_formula")

ROWS: dict[str, tuple[str, int, dict[str, Any]]] = {
    **{f"single environment, {env_id}": (env_id, 0, {}) for env_id in (STAB, LANE_CHANGE)},
    "single environment, quadratic reward": (STAB, 0, {"reward": "quadratic"}),
    **{f"single environment, {tire}": (STAB, 0, {"tire": tire}) for tire in ("linear", "tanh", "magic_formula")},
    **{f"{tire}, N = 4096": (STAB, 4096, {"tire": tire}) for tire in TIRES},
    "tanh, N = 1024": (STAB, 1024, {"tire": "tanh"}),
    "linear, N = 1024": (STAB, 1024, {"tire": "linear"}),
    "linear, N = 16384": (STAB, 16384, {"tire": "linear"}),
    **{f"{tire}, float32, N = 4096": (STAB, 4096, {"tire": tire, "dtype": "float32"}) for tire in TIRES},
    **{f"{tire}, two threads, N = 16384": (STAB, 16384, {"tire": tire, "threads": 2}) for tire in TIRES[1:]},
    "tanh, N = 1": (STAB, 1, {"tire": "tanh"}),
    "tanh, N = 64": (STAB, 64, {"tire": "tanh"}),
    "lane change, N = 1024": (LANE_CHANGE, 1024, {}),
}
"""Name -> id, number of cars (0: the single environment), keywords."""
SECONDS = 0.15  # of one turn, about
TURNS = 5  # of each process in a round


def stepping(env_id: str, num_envs: int, keywords: dict[str, Any]) -> Callable[[int], float]:
    """``play(steps) -> seconds``."""
    import gymnasium as gym

    import bicycle_env  # noqa: F401

    env: Any = gym.make_vec(env_id, num_envs, **keywords) if num_envs else gym.make(env_id, **keywords)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(8)]
    env.reset(seed=0)
    clock = time.perf_counter if "threads" in keywords else time.process_time

    def play(steps: int) -> float:
        start = clock()
        for k in range(steps):
            _, _, terminated, truncated, _ = env.step(actions[k % 8])
            if not num_envs and (terminated or truncated):
                env.reset()
        return clock() - start

    return play


def work() -> None:
    """Answer the parent: a line [row, steps] on standard input gives a line of seconds."""
    plays: dict[str, Callable[[int], float]] = {}
    for line in sys.stdin:
        name, steps = json.loads(line)
        if name not in plays:
            plays[name] = stepping(*ROWS[name])
        print(plays[name](steps), flush=True)


class Worker:
    """A process that runs one checkout."""

    def __init__(self, folder: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, __file__, "--worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(folder)},
        )

    def __call__(self, name: str, steps: int) -> float:
        if self._process.stdin is None or self._process.stdout is None:
            raise RuntimeError("the worker has no pipes")
        self._process.stdin.write(json.dumps([name, steps]) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise RuntimeError(f"the worker stopped at {name!r}: see its message above")
        return float(answer)

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


class Round(NamedTuple):
    """Of one row, in two processes."""

    ratio: float
    """Speed of this tree over the other's: the median of the turns."""
    rate: float
    """Rows a second, of this tree."""


def race(mine: Worker, theirs: Worker, name: str) -> Round:
    """Both in turns, each first every other time."""
    for worker in (mine, theirs):
        worker(name, 2)
    steps = max(1, int(SECONDS / max(mine(name, 20) / 20, 1e-7)))
    turns = []
    for k in range(TURNS):
        seconds = [0.0, 0.0]
        for j in (0, 1) if k % 2 else (1, 0):
            seconds[j] = (mine, theirs)[j](name, steps)
        turns.append(seconds)
    ratio = statistics.median(before / now for now, before in turns)
    return Round(ratio, max(1, ROWS[name][1]) * steps / statistics.median(now for now, _ in turns))


@contextlib.contextmanager
def checkout(name: str) -> Iterator[Path]:
    """The folder of a revision: a folder that is there, or a temporary worktree."""
    if Path(name).is_dir():
        yield Path(name).resolve()
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "revision"
        subprocess.run(["git", "-C", ROOT, "worktree", "add", "-q", "--detach", folder, name], check=True)
        try:
            yield folder
        finally:
            subprocess.run(["git", "-C", ROOT, "worktree", "remove", "--force", folder], check=False)


def interval(values: list[float]) -> tuple[float, float]:
    """Order statistics that hold the median with at least 95 %, or with what so few values give."""
    ordered, n = sorted(values), len(values)
    k = 0
    while 2 * sum(math.comb(n, j) for j in range(k + 2)) / 2**n <= 0.05:
        k += 1
    return ordered[k], ordered[n - 1 - k]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", nargs="?", help="the other revision, or the folder of a checkout of it")
    parser.add_argument("--rounds", type=int, default=9, help="rounds of each row, at least 7 (default 9)")
    parser.add_argument("--only", default="", help="rows whose name contains this")
    parser.add_argument("--must", type=float, default=0.95, help="least ratio (default 0.95)")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        work()
        return 0
    if options.before is None or options.rounds < 7:
        parser.error("name the other revision; --rounds must be at least 7")

    names = [name for name in ROWS if options.only in name]
    rounds: dict[str, list[Round]] = {name: [] for name in names}
    with checkout(options.before) as folder:
        for number in range(options.rounds):
            workers = Worker(ROOT), Worker(folder)
            try:
                for k, name in enumerate(names):
                    told = f"\rround {number + 1} of {options.rounds}: {k + 1} of {len(names)} rows"
                    print(told if sys.stderr.isatty() else "", end="", file=sys.stderr, flush=True)
                    rounds[name].append(race(*workers, name))
            finally:
                for worker in workers:
                    worker.close()
    print(f"{'this tree / ' + options.before:42s} {'median':>7s}  {'interval':15s} {'now, rows/s':>13s}")
    table = []
    for name, of_row in rounds.items():
        ratios = [one.ratio for one in of_row]
        median, (low, high) = statistics.median(ratios), interval(ratios)
        rate = statistics.median(one.rate for one in of_row)
        table.append(
            {"row": name, "ratio": round(median, 3), "interval": [round(low, 3), round(high, 3)], "now": round(rate)}
        )
        mark = "" if median >= options.must else "  SHORT"
        print(f"{name:42s} {median:7.3f}  [{low:.3f}, {high:.3f}] {rate:14,.0f}{mark}")
    if options.json:
        command = f"python benchmarks/revisions.py {options.before} --rounds {options.rounds}"
        write_json(options.json, {"command": command, **provenance.collect(), "must": options.must, "ratios": table})
    return 1 if any(row["ratio"] < options.must for row in table) else 0


if __name__ == "__main__":
    sys.exit(main())
