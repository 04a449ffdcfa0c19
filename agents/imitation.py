"""A warm start: a network learns what a controller does, where the network itself drives (DAgger, arXiv:1011.0686)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from bicycle_env.control import Policy

ROUNDS = 4
"""The controller drives in the first one, the network in the others."""
CARS = 512
GRADIENT_STEPS, MINIBATCH, LEARNING_RATE = 600, 4096, 2e-3
"""Of each round, over all that was driven so far."""


def imitate(network: nn.Module, teacher: Policy, cars: Any, seeds: Sequence[int], hold: int, history: int) -> float:
    """Teach a network the controller's actions; gives the mean squared difference that is left.

    Args:
        network: of the observations of the last `history` decisions, the newest first.
        teacher: the controller; it acts at every control step, and is copied where the network decides.
        cars: of the environment, a native vector environment with autoreset_mode="Disabled" (``optimum.Cars.of``).
        seeds: of the starts: `ROUNDS` for each car.
        hold: control steps from one decision to the next.
    """
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE)
    seen: list[Tensor] = []
    wanted: list[Tensor] = []
    loss = torch.zeros(())
    for k in range(ROUNDS):
        count = cars.num_envs
        for some_seen, some_wanted in _driven(
            network, teacher, cars, seeds[k * count : (k + 1) * count], k, hold, history
        ):
            seen.append(some_seen), wanted.append(some_wanted)
        x, y = torch.cat(seen), torch.cat(wanted)
        for _ in range(GRADIENT_STEPS):
            rows = torch.randint(len(x), (MINIBATCH,))
            loss = (network(x[rows]) - y[rows]).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    return float(loss.detach())


def _driven(
    network: nn.Module, teacher: Policy, cars: Any, seeds: Sequence[int], k: int, hold: int, history: int
) -> list[tuple[Tensor, Tensor]]:
    """One episode of each car: at every decision what was seen and what the teacher would do, of cars still driving."""
    observation, _ = cars.reset(seed=list(seeds))
    teacher.reset()
    entries, step, found = observation.shape[1], 0, []
    seen, running = np.tile(observation, history), np.ones(len(observation), np.bool_)
    action = np.zeros((len(observation), cars.single_action_space.shape[0]), np.float32)
    while np.any(running):
        wanted = teacher.act(observation)
        if step % hold == 0:
            if step:
                seen = np.hstack((observation, seen[:, :-entries]))
            inputs = torch.from_numpy(seen)
            found.append((inputs[torch.from_numpy(running)], torch.from_numpy(wanted[running])))
            with torch.no_grad():
                action = network(inputs).numpy()
        used = wanted if k == 0 else np.clip(action, -1.0, 1.0).astype(np.float32)
        observation, _, terminated, truncated, _ = cars.step(used)
        running &= ~(terminated | truncated)
        step += 1
    return found
