"""Speed of the native vector environment as ratios, each measured in one run: rounds alternate, the best counts.

Rates are per second of processor time, of all threads together; for two threads against one, of wall time.

    pip install -c constraints.txt -e ".[bench]" && python benchmarks/vector_env.py --json results/vector_env.json

Prints measured / must and exits 1 if a ratio falls short; a peer that cannot be imported is named, and its rows are
left open (exit 2). Against C: benchmarks/limit. One thread unless said. `--only` takes a part of a row's name.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from limit import build, peak
from rivals import numpy_step, sb3_ratio

import bicycle_env
from bicycle_env import provenance
from bicycle_env.files import write_json
from bicycle_env.tasks.active_steer import ActiveSteer

ENV_ID = "BicycleStab-v0"
TWIN_ID = "BicycleActiveSteer-v0"
TWINLESS_ID = "Benchmark/ActiveSteerWithoutTwin-v0"
NONLINEAR = ("tanh", "fiala", "magic_formula")
SECONDS = 0.15  # of one round, about

Round = Callable[[int], int]
"""Take some steps, return how many rows they moved."""


class Row(NamedTuple):
    """What is measured against what."""

    name: str
    must: float
    ours: Callable[[], Round]
    theirs: Callable[[], Round]
    clock: Callable[[], float] = time.process_time
    """Time of the processor, all threads together, which other work on the machine disturbs least; wall time where
    threads are what is measured."""


def stepping(make: Callable[[], Any], rows: int) -> Round:
    """Steps of a vector environment with sampled actions."""
    env = make()
    if hasattr(env, "single_action_space"):
        env.action_space.seed(0)
        actions = [env.action_space.sample() for _ in range(8)]
        env.reset(seed=0)
    else:
        actions = [env.action_space.sample() for _ in range(8)]
        env.reset()

    def play(count: int) -> int:
        for k in range(count):
            env.step(actions[k % 8])
        return count * rows

    return play


def ours(num_envs: int, env_id: str = ENV_ID, **keywords: Any) -> Callable[[], Round]:
    return lambda: stepping(lambda: gym.make_vec(env_id, num_envs=num_envs, **keywords), num_envs)


class WithoutTwin(ActiveSteer):
    """The twin stays where it began: what integrating it costs is the difference."""

    name = "active_steer_without_twin"
    companions = ()

    def accompany(self, *_: Any) -> None:
        return None


def kernel(tire: str, in_c: bool, num_envs: int = 4096) -> Callable[[], Round]:
    """The bare kernel, ours or C's, on the same blocks."""

    def prepare() -> Round:
        env = gym.make_vec(ENV_ID, num_envs=num_envs, tire=tire)
        env.reset(seed=0)
        env.action_space.seed(0)
        step = build.kernel(tire) if in_c else env.unwrapped._kernels.step
        rows, generators = env.unwrapped._rows, env.unwrapped._generators.addresses
        start = rows.numbers.copy()
        results = env.unwrapped._new_results()
        actions = env.action_space.sample()

        def play(count: int) -> int:
            for k in range(count):
                if k % 8 == 0:
                    rows.numbers[:] = start  # cars that have ended would wait
                step(rows.numbers, actions, generators, *results, False, 0, rows.blocks)
            return count * num_envs

        return play

    return prepare


def cart_pole(num_envs: int) -> Callable[[], Round]:
    return lambda: stepping(lambda: gym.make_vec("CartPole-v1", num_envs=num_envs), num_envs)


def pendulum(num_envs: int) -> Callable[[], Round]:
    def prepare() -> Round:
        import envpool

        env = envpool.make("Pendulum-v1", env_type="gymnasium", num_envs=num_envs, num_threads=1)
        env.reset()
        actions = [np.random.default_rng(k).uniform(-2.0, 2.0, (num_envs, 1)).astype(np.float32) for k in range(8)]

        def play(count: int) -> int:
            for k in range(count):
                env.step(actions[k % 8])
            return count * num_envs

        return play

    return prepare


def single(tire: str) -> Callable[[], Round]:
    def prepare() -> Round:
        env = gym.make(ENV_ID, tire=tire)
        env.reset(seed=0)
        env.action_space.seed(0)
        actions = [env.action_space.sample() for _ in range(8)]

        def play(count: int) -> int:
            for k in range(count):
                _, _, terminated, truncated, _ = env.step(actions[k % 8])
                if terminated or truncated:
                    env.reset()
            return count

        return play

    return prepare


ROWS = [
    Row("linear / C, float64, N = 4096", 0.9, kernel("linear", False), kernel("linear", True)),
    *(Row(f"{t} / C with libmvec, N = 4096", 1.0, kernel(t, False), kernel(t, True)) for t in NONLINEAR),
    Row("tanh / envpool Pendulum-v1, N = 1024", 4.0, ours(1024, tire="tanh"), pendulum(1024)),
    Row("tanh / numpy arrays, N = 1024", 5.0, ours(1024, tire="tanh"), numpy_step(ENV_ID, 1024, "tanh")),
    Row("linear / CartPoleVectorEnv, N = 1024", 2.3, ours(1024, tire="linear"), cart_pole(1024)),
    Row("linear / CartPoleVectorEnv, N = 16384", 1.0, ours(16384, tire="linear"), cart_pole(16384)),
    *(
        Row(f"{t}: float32 / float64, N = 4096", 2.0, ours(4096, tire=t, dtype="float32"), ours(4096, tire=t))
        for t in NONLINEAR
    ),
    *(
        Row(
            f"{t}: two threads / one, N = 16384",
            1.6,
            ours(16384, tire=t, threads=2),
            ours(16384, tire=t),
            time.perf_counter,
        )
        for t in NONLINEAR
    ),
    Row("ActiveSteer: with its twin / without, N = 1024", 0.5, ours(1024, TWIN_ID), ours(1024, TWINLESS_ID)),
    Row("tanh, N = 1 / single environment", 1.0, ours(1, tire="tanh"), single("tanh")),
    Row("tanh, N = 64 / single environment", 1.0, ours(64, tire="tanh"), single("tanh")),
]
SB3_ROW = ("SB3 PPO, n_envs = 64 / null environment", 0.95)


def contest(row: Row, rounds: int) -> tuple[float, float]:
    """Best rates [rows/s] of both."""
    best = [0.0, 0.0]
    plays = (row.ours(), row.theirs())
    counts = []
    for play in plays:
        play(1)
        start = row.clock()
        play(3)
        counts.append(max(1, int(SECONDS / max((row.clock() - start) / 3, 1e-7))))
    # Two threads need both cores at once, which on a machine with other work is rare: more rounds.
    for _ in range(rounds if row.clock is time.process_time else 5 * rounds):
        for k, play in enumerate(plays):
            start = row.clock()
            moved = play(counts[k])
            best[k] = max(best[k], moved / (row.clock() - start))
    return best[0], best[1]


def first_call() -> float:
    """Seconds from a new interpreter's first line to the end of a first step, the cache being warm; less imports."""
    program = (
        "import time, gymnasium as gym, numpy as np, bicycle_env, numba, scipy.linalg, gymnasium.vector\n"
        "start = time.perf_counter()\n"
        f"env = gym.make_vec('{ENV_ID}', num_envs=1024)\n"
        "env.reset(seed=0); env.step(np.zeros((1024, 2), np.float32))\n"
        "print(time.perf_counter() - start)\n"
    )
    runs = [subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True) for _ in "123"]
    return min(float(run.stdout) for run in runs)


def cost_by_number(most: int) -> dict[str, dict[str, float]]:
    """Rows/s against the number of rows, ours and the peers'."""
    contestants = {
        "linear": lambda n: ours(n, tire="linear"),
        "tanh": lambda n: ours(n, tire="tanh"),
        "fiala": lambda n: ours(n, tire="fiala"),
        "fiala, float32": lambda n: ours(n, tire="fiala", dtype="float32"),
        "fiala, two threads": lambda n: ours(n, tire="fiala", threads=2),
        "CartPoleVectorEnv": cart_pole,
        "envpool Pendulum-v1": pendulum,
    }
    rates: dict[str, dict[str, float]] = {}
    numbers = [n for n in (1, 4, 16, 64, 256, 1024, 4096, 16384, 65536, 262144, 1_000_000) if n <= most]
    for name, make in contestants.items():
        for n in numbers:
            if name == "envpool Pendulum-v1" and n > 16384:
                continue
            try:
                play = make(n)()
            except ImportError:
                break
            play(1)
            start = time.perf_counter()
            play(1)
            count = max(1, int(SECONDS / max(time.perf_counter() - start, 1e-7)))
            best = 0.0
            for _ in range(3):
                start = time.perf_counter()
                best = max(best, play(count) / (time.perf_counter() - start))
            rates.setdefault(name, {})[str(n)] = round(best)
            print(f"  {name:22s} N = {n:9,d} {best / 1e6:10.3f} million/s", flush=True)
    return rates


def memory() -> dict[str, float]:
    """Bytes per car: the numbers of the blocks, and with generators and flags (as the operating system sees it)."""
    import resource

    env = gym.make_vec(ENV_ID, num_envs=100_000)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    env.reset(seed=0)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "blocks": round(env.unwrapped._rows.numbers.nbytes / 100_000, 1),
        "generators and a reset": round((after - before) * 1024 / 100_000, 1),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=9, help="rounds, of which the best counts (default 9)")
    parser.add_argument("--only", default="", help="rows whose name contains this")
    parser.add_argument("--most", type=int, default=0, help="also cost against N, up to so many cars (1000000)")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()

    bicycle_env.register(TWINLESS_ID, WithoutTwin, max_episode_steps=WithoutTwin.episode_steps)
    table: list[dict[str, Any]] = []
    short, open_rows = False, []
    print(f"{'ratio':44s} {'measured':>9s} {'must':>6s}   {'ours':>12s} {'theirs':>12s}")
    for row in ROWS:
        if options.only not in row.name:
            continue
        try:
            mine, other = contest(row, options.rounds)
        except ImportError as error:
            open_rows.append(row.name)
            print(f"{row.name:44s} not measured: {error}", flush=True)
            continue
        ratio = mine / other
        short |= ratio < row.must
        table.append(
            {"row": row.name, "ratio": round(ratio, 2), "must": row.must, "ours": round(mine), "theirs": round(other)}
        )
        mark = "" if ratio >= row.must else "  SHORT"
        print(f"{row.name:44s} {ratio:9.2f} {row.must:6.2f}   {mine:12,.0f} {other:12,.0f}{mark}", flush=True)
    if options.only in SB3_ROW[0]:
        try:
            ratio = sb3_ratio()
            short |= ratio < SB3_ROW[1]
            table.append({"row": SB3_ROW[0], "ratio": round(ratio, 3), "must": SB3_ROW[1]})
            print(f"{SB3_ROW[0]:44s} {ratio:9.3f} {SB3_ROW[1]:6.2f}{'' if ratio >= SB3_ROW[1] else '  SHORT'}")
        except ImportError as error:
            open_rows.append(SB3_ROW[0])
            print(f"{SB3_ROW[0]:44s} not measured: {error}", flush=True)
    report: dict[str, Any] = {"ratios": table, "not measured": open_rows}
    if not options.only:
        report["first step in a new process, s"] = round(first_call(), 2)
        report["bytes per car"] = memory()
        print(json.dumps({key: report[key] for key in ("first step in a new process, s", "bytes per car")}))
        if report["first step in a new process, s"] >= 1.0:
            short = True
            print("the first step in a new process must take less than a second  SHORT")
    if options.most:
        limit = peak.measure()
        report["limit"] = {
            **limit._asdict(),
            "operations of a step": {name: peak.operations(name) for name in ("linear", *NONLINEAR)},
        }
        report["rows per second"] = cost_by_number(options.most)
    if options.json:
        command = "python benchmarks/vector_env.py" + (f" --most {options.most}" if options.most else "")
        write_json(options.json, {"command": command, **provenance.collect(), **report})
    return 1 if short else 2 if open_rows else 0


if __name__ == "__main__":
    sys.exit(main())
