"""Cells as agents.benchmark writes them, made up: with the success of each seed."""

from __future__ import annotations

from agents.benchmark import PROFILE
from agents.statistics import bootstrap, iqm


def over(values):
    return {"value": iqm(values), "interval": list(bootstrap(values, iqm)), "range": [min(values), max(values)]}


def share(value):
    return {"value": value, "interval": [value - 0.02, value + 0.02]}


def cell(env_id, level, learner, rates, classical=0.7, steps=3e6, seconds=60.0, controller="lqr"):
    """Seeds that rise to their rates within half of the training, and stay."""
    trainings = [
        {
            "seed": seed,
            "timesteps": int(steps),
            "seconds": seconds + seed,
            "success_rate": share(rate),
            "on_road_rate": share(rate),
            "episode_return": share(100.0 * rate),
            "curve": [[int(steps * k / 20), (seconds + seed) * k / 20, rate * min(1.0, k / 10)] for k in range(1, 21)],
        }
        for seed, rate in enumerate(rates)
    ]
    better = iqm(rates) - classical
    return {
        "env_id": env_id,
        "level": level,
        "learner": learner,
        "variant": "",
        "machine": "A machine, 2 cores, Linux",
        "date": "2026-11-27",
        "classical": {"controller": controller, "success_rate": share(classical)},
        "trainings": trainings,
        "over_seeds": {
            "success_rate": over(rates),
            "on_road_rate": over(rates),
            "episode_return": over([100.0 * rate for rate in rates]),
        },
        "better_than_classical": {"value": better, "interval": [better - 0.02, better + 0.02]},
        "profile": [sum(rate >= level for rate in rates) / len(rates) for level in PROFILE],
    }
