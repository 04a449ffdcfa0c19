"""Steps per second of TorchVectorEnv against the number of cars, on the CPU and on a GPU where there is one.

    pip install -c constraints.txt -e ".[agents]" && python benchmarks/torch_env.py --json results/torch_env.json
    python benchmarks/torch_env.py --devices cuda --sizes 1024 16384 131072 1048576 --json results/torch_env_gpu.json

Random actions, autoreset in the same step, no gradients. On the CPU one thread, in processor time, which other work on
the machine disturbs least, and beside it the native vector environment. On a GPU elapsed time; it is waited for at the
end of each round only. Each keeps its best round.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
import torch._inductor.config

from bicycle_env import provenance
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.files import write_json

ENV_ID = "BicycleStab-v0"
SIZES = (1, 64, 1024, 16384, 131072)
ROUNDS = 3
SHORTEST_ROUND = 0.3  # s


def torch_stepper(device: str, num_envs: int, dtype: str, compiled: bool) -> tuple[Callable[[int], None], float]:
    """``run(steps)``, and the seconds that the first steps took, compilation included."""
    modes = {"autoreset_mode": "SameStep", "on_invalid": "terminate"}  # nothing waits for the host
    envs = TorchVectorEnv(ENV_ID, num_envs, device=device, dtype=dtype, compile=compiled, **modes)
    envs.reset(seed=0)
    generator = torch.Generator(device=device).manual_seed(0)
    shape = (16, num_envs, *envs.single_action_space.shape)
    actions = 2.0 * torch.rand(shape, generator=generator, device=device) - 1.0

    def run(steps: int) -> None:
        for k in range(steps):
            envs.step(actions[k % 16])
        if device != "cpu":
            torch.cuda.synchronize()

    start = time.perf_counter()
    run(2)
    return run, time.perf_counter() - start


def native_stepper(num_envs: int, dtype: str) -> tuple[Callable[[int], None], float]:
    """The same for the compiled vector environment."""
    envs = gym.make_vec(ENV_ID, num_envs=num_envs, dtype=dtype, autoreset_mode="SameStep")
    envs.reset(seed=0)
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(16)]

    def run(steps: int) -> None:
        for k in range(steps):
            envs.step(actions[k % 16])

    start = time.perf_counter()
    run(2)
    return run, time.perf_counter() - start


def rate(run: Callable[[int], None], num_envs: int, rounds: int, clock: Callable[[], float]) -> float:
    """Steps of single cars per second: the best of some rounds, each long enough to measure."""
    steps, best = 1, 0.0
    while rounds:
        start = clock()
        run(steps)
        seconds = clock() - start
        best = max(best, steps * num_envs / seconds)
        if seconds < SHORTEST_ROUND:
            steps *= 2
        else:
            rounds -= 1
    return best


def variants(devices: list[str]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for device in devices:
        for dtype in ("float64", "float32"):
            rows += [{"what": "torch", "device": device, "dtype": dtype, "compile": c} for c in (False, True)]
            if device == "cpu":
                rows.append({"what": "native", "device": device, "dtype": dtype})
    return rows


def measure(row: dict[str, Any], sizes: list[int], rounds: int) -> None:
    """Fill in the rates of a variant and the seconds that its first steps took; prints a line."""
    row["steps_per_second"], row["first_steps_seconds"] = {}, {}
    kind = " ".join((row["what"], row["device"], row["dtype"], "compiled" if row.get("compile") else "")).rstrip()
    print(f"{kind:32s}", end="", flush=True)
    clock = time.process_time if row["device"] == "cpu" else time.perf_counter
    for size in sizes:
        if row["what"] == "native":
            run, first = native_stepper(size, row["dtype"])
        else:
            run, first = torch_stepper(row["device"], size, row["dtype"], row["compile"])
        row["first_steps_seconds"][str(size)] = round(first, 2)
        row["steps_per_second"][str(size)] = round(rate(run, size, rounds, clock))
        print(f"{row['steps_per_second'][str(size)]:14,d}", end="", flush=True)
    print()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="numbers of cars")
    parser.add_argument(
        "--devices", nargs="+", choices=("cpu", "cuda"), help="default: cpu, and cuda where there is one"
    )
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="rounds, of which the best counts (default 3)")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    torch._inductor.config.force_disable_caches = True  # the first steps compile, whatever ran before
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    found = torch.cuda.is_available()
    devices = options.devices or ["cpu", *(["cuda"] if found else [])]
    if "cuda" in devices and not found:
        parser.error("--devices cuda: torch finds no GPU here")
    gpu = torch.cuda.get_device_name() if found else "none at hand: not measured"
    print(f"{provenance.machine()}; GPU: {gpu}\n")
    print(f"{'steps/s':32s}" + "".join(f"{size:>14,d}" for size in options.sizes))
    rows = variants(devices)
    for row in rows:
        measure(row, options.sizes, options.rounds)
    if options.json:
        chosen = f" --devices {' '.join(options.devices)}" if options.devices else ""
        if list(options.sizes) != list(SIZES):
            chosen += f" --sizes {' '.join(map(str, options.sizes))}"
        if options.rounds != ROUNDS:
            chosen += f" --rounds {options.rounds}"
        result = {
            "command": "python benchmarks/torch_env.py" + chosen,
            **provenance.collect(),
            "gpu": gpu,
            "env_id": ENV_ID,
            "threads": 1,
            "rows": rows,
        }
        write_json(options.json, result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
