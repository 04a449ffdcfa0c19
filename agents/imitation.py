"""A warm start: a network learns what a controller does, where the network itself drives (DAgger, arXiv:1011.0686)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from agents import scores
from agents.episodes import start_seeds
from agents.messages import UserError
from bicycle_env import control, optimum
from bicycle_env.control import Policy

ROUNDS = 4
"""The controller drives in the first one, the network in the others."""
CARS = 512
PLANNED = 192
"""Starts of an iteration of the search for a plan."""
GRADIENT_STEPS, MINIBATCH, LEARNING_RATE = 600, 4096, 2e-3
"""Of each round, over all that was driven so far."""


def begin(network: nn.Module, args: Any, keywords: Mapping[str, Any], cars: optimum.Cars) -> None:
    """Let a network begin as the image of the controller `args.imitate`, which with `args.plan` first learns to plan.

    Raises:
        UserError: there is none of that name for these cars, or it cannot plan.
    """
    plant = cars.plant
    name = plant.spec.id if plant.spec is not None else ""
    parameters = scores.tuned(name, plant.scored_level, args.imitate)
    try:
        teacher = control.make(args.imitate, plant, parameters=parameters)
    except (TypeError, ValueError, np.linalg.LinAlgError) as error:
        raise UserError(f"--imitate: {error}") from None
    if args.plan:
        if not isinstance(teacher, control.TunableLaw):
            raise UserError(f"--plan: {args.imitate} has no parameters that may differ from car to car")
        seeds = [start_seeds(PLANNED, args.seed + 1000 * (k + 1), "tune") for k in range(args.plan)]
        teacher = optimum.search_plan(
            args.env_id, keywords, teacher, seeds.__getitem__, iterations=args.plan, seed=args.seed
        )
    starts = start_seeds(ROUNDS * CARS, args.seed, "tune")
    imitate(network, teacher, cars.of(CARS), starts, args.hold, args.history)


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
