"""Draw rows per second against the number of cars, from what benchmarks/vector_env.py wrote.

python benchmarks/picture.py --json results/vector_env.json --out docs/performance.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

from bicycle_env import plots
from bicycle_env.files import read_json

BYTES = {"linear": 2 * 96 + 32 + 8 + 16 + 3}
"""Read and written per row and step: the block twice, observation, action, reward and cost, flags and end."""
PEERS = ("CartPoleVectorEnv", "envpool Pendulum-v1")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, default=Path("runs/vector_env.json"), help="the figures")
    parser.add_argument("--out", type=Path, default=Path("runs/performance.png"), help="the picture")
    options = parser.parse_args()
    report = read_json(options.json)
    rates, limit = report["rows per second"], report["limit"]
    figure = plots.new_figure(9.0, 6.0, "One control step (five RK4 steps) of many cars, rows per second")
    axes = figure.subplots()
    for k, (name, found) in enumerate(rates.items()):
        look = plots.line_style(k)
        axes.plot(
            [int(n) for n in found],
            list(found.values()),
            color=look.color,
            linestyle=":" if name in PEERS else "-",
            marker="s" if name in PEERS else "o",
            markersize=4,
            label=name,
        )
    for name, line in (("linear", "--"), ("fiala", "-.")):
        steps = 2.0 * limit["multiply_adds"] / sum(limit["operations of a step"][name].values())
        axes.axhline(steps, color="0.3", linestyle=line, linewidth=1.0, label=f"limit of one core, {name}, float64")
    memory = limit["bytes_per_second"] / BYTES["linear"]
    axes.axhline(memory, color="0.6", linestyle=(0, (1, 1)), linewidth=1.0, label="limit of the memory, one core")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("number of cars in the vector environment")
    axes.set_ylabel("rows per second")
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    plots.save(figure, options.out)


if __name__ == "__main__":
    main()
