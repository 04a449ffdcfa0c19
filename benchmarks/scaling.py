"""Control steps per second of trainings with agents.ppo: one at a time, two, and so on to as many as there are cores.

    pip install -c constraints.txt -e ".[agents]" && python benchmarks/scaling.py --json results/scaling.json

Each training is a process of its own with a seed of its own, as agents.jobs and agents.benchmark start them. A rate is
that of the training's own clock, run.json, without the start of Python; "with the start" is by the clock on the wall,
from the first start to the last end. Beside them the same cars alone, in one process, with random actions: what is left
of a training's second is the networks'. Of some rounds, which take turns, each number of trainings keeps its best.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import gymnasium as gym

import bicycle_env  # noqa: F401  (registers the environments)
from bicycle_env import provenance
from bicycle_env.files import write_json

ROOT = Path(__file__).parents[1]
ENV_ID = "BicycleStab-v0"
STEPS, QUICK_STEPS = 1_000_000, 100_000
"""Of a training: some twenty seconds."""
ROUNDS = 2


def counts_up_to(most: int) -> list[int]:
    """1, 2, 4, ... and the last."""
    return sorted({*(2**k for k in range(most.bit_length())), most})


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def trained(at_once: int, steps: int, folder: Path) -> dict[str, Any]:
    """So many trainings side by side, from their start to the end of the last."""
    places = [folder / str(seed) for seed in range(at_once)]
    words = [sys.executable, "-m", "agents.ppo", "--env-id", ENV_ID, "--total-timesteps", str(steps), "--quiet"]
    start = time.perf_counter()
    running = [
        subprocess.Popen([*words, "--seed", str(seed), "--out", str(place)], cwd=ROOT, stdout=subprocess.DEVNULL)
        for seed, place in enumerate(places)
    ]
    codes = [process.wait() for process in running]
    wall = time.perf_counter() - start
    if any(codes):
        raise SystemExit(f"a training has failed: exit codes {codes}")
    runs = [json.loads((place / "run.json").read_text(encoding="utf-8")) for place in places]
    rates = [run["timesteps"] / run["seconds"] for run in runs]
    return {
        "at_once": at_once,
        "steps_per_second_each": [round(rate) for rate in rates],
        "steps_per_second": round(sum(rates)),
        "with_the_start": round(sum(run["timesteps"] for run in runs) / wall),
        "cars": runs[0]["settings"]["cars"],
    }


def cars_alone(number: int, seconds: float = 2.0) -> int:
    """Control steps per second of the native vector environment on one core, with random actions."""
    envs = gym.make_vec(ENV_ID, num_envs=number, autoreset_mode="SameStep")
    envs.reset(seed=0)
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(16)]
    envs.step(actions[0])  # compiled
    steps, start = 0, time.process_time()
    while (spent := time.process_time() - start) < seconds:
        envs.step(actions[steps % 16])
        steps += 1
    return round(steps * number / spent)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most", type=int, default=cores(), help="trainings at a time, at most (default: the cores)")
    parser.add_argument("--steps", type=int, help=f"of each training (default {STEPS})")
    parser.add_argument("--rounds", type=int, help=f"of which the best counts (default {ROUNDS})")
    parser.add_argument("--quick", action="store_true", help="one round of a tenth: to see that it works")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    if min(options.most, options.steps or 1, options.rounds or 1) < 1:
        parser.error("--most, --steps and --rounds must be at least 1")
    steps = options.steps or (QUICK_STEPS if options.quick else STEPS)
    rounds = options.rounds or (1 if options.quick else ROUNDS)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    print(f"{provenance.machine()}; {cores()} cores to be used, load before: {load}\n")
    best: dict[int, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        trained(1, 1, Path(folder) / "compiled")  # once for this machine, before anything is measured
        for turn in range(rounds):
            for at_once in counts_up_to(options.most):
                row = trained(at_once, steps, Path(folder) / f"{turn}-{at_once}")
                best[at_once] = max(best.get(at_once, row), row, key=lambda one: one["steps_per_second"])
    rows = [best[at_once] for at_once in sorted(best)]
    alone = cars_alone(rows[0]["cars"])
    print(
        f"{'trainings at a time':>20s} {'steps/s each':>14s} {'together':>12s} {'of as many':>11s} {'with start':>12s}"
    )
    for row in rows:
        row["of_as_many"] = round(row["steps_per_second"] / (row["at_once"] * rows[0]["steps_per_second"]), 3)
        each = row["steps_per_second"] / row["at_once"]
        print(
            f"{row['at_once']:20d} {each:14,.0f} {row['steps_per_second']:12,d} {row['of_as_many']:11.0%} "
            f"{row['with_the_start']:12,d}"
        )
    print(f"the cars alone, {rows[0]['cars']} of them on one core: {alone:,} steps/s")
    if options.json:
        chosen = [f"--{name} {value}" for name in ("steps", "rounds") if (value := getattr(options, name))]
        chosen += [f"--most {options.most}"] * (options.most != cores()) + ["--quick"] * options.quick
        result = {
            "command": " ".join(["python benchmarks/scaling.py", *chosen]),
            **provenance.collect(),
            "env_id": ENV_ID,
            "cores": cores(),
            "load_before": load,
            "quick": options.quick,
            "steps": steps,
            "rounds": rounds,
            "cars_alone": alone,
            "rows": rows,
        }
        write_json(options.json, result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
