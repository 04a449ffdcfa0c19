"""An evolution strategy over the weights of a small network (T. Salimans et al., arXiv:1703.03864), in this one file.

    python -m agents.policy_search --env-id BicycleActiveSteer-v0 --seed 0 --out runs/search

No gradient, no critic, no noise on the actions: networks are drawn in pairs about their mean, each drives some starts,
all at once in the native vector environment, and the mean moves towards those that did better. What they are ranked by
is the success rate plus the mean reward per step of a full episode, as for the classical controllers (agents.tune). The
search over the gains of a law that has a structure is agents.tune itself.

The folder holds what agents.train writes: policy.safetensors and policy.json, run.json, curve.csv, checkpoint/.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from rich.console import Console

import bicycle_env  # noqa: F401  (registers the environments)
from agents import generators, messages, settings, state_arrays, stopping, training
from agents.episodes import start_seeds
from agents.evaluate import make_env, parse_keywords
from bicycle_env import optimum
from bicycle_env.backends import announcements

ALGORITHM = "policy-search"
Array = NDArray[np.float32]


@dataclass
class Args:
    """Search for the weights of a policy; what is not given is as agents/configs says for the id."""

    env_id: str = "BicycleStab-v0"
    """Environment id."""
    env_keywords: str = "{}"
    """Keywords of the environment as JSON, for example '{"level": "hard"}'."""
    seed: int = 0
    """Seed of the first mean, of what is drawn about it, and of the starts."""
    out: Path | None = None
    """Folder of the run; by default runs/ENV_ID-policy-search-SEED."""
    resume: bool = False
    """Go on from the last checkpoint in the folder."""
    quiet: bool = False
    """No progress, and no word about what compiles."""

    total_timesteps: int = 60_000_000
    """Control steps of all cars together, as if every episode lasted to its time limit; rounded up to whole
    iterations."""
    pairs: int = 64
    """Networks drawn in an iteration, each with its mirror image about the mean."""
    starts: int = 16
    """Episodes that each drives, the same for all."""
    hold: int = 1
    """Control steps for which an action is held."""
    history: int = 1
    """How many observations the policy sees: those of its last decisions."""
    width: int = 16
    """Of the hidden layer."""
    deviation: float = 0.05
    """Of the weights that are drawn, about their mean."""
    learning_rate: float = 0.03
    """Of Adam, at first; it falls to 0."""
    mirrored: bool = True
    """Mirror images are answered by mirror images."""


class Networks:
    """Many networks of one shape, their weights in rows; each drives as many cars, which stand together."""

    def __init__(self, args: Args, plant: Any) -> None:
        self._entries, self._axles = len(plant.observation_names), plant.action_space.shape[0]
        self._args = args
        self._shapes: list[tuple[int, int]] = []
        sizes = [self._entries * args.history, args.width, self._axles]
        for width, next_width in itertools.pairwise(sizes):
            self._shapes += [(width, next_width), (1, next_width)]
        self.count = sum(a * b for a, b in self._shapes)
        mirror = plant.observation_mirror.astype(np.float32)
        self._mirror = np.tile(mirror, args.history) if args.mirrored else None

    def first(self, random: np.random.Generator) -> Array:
        """(weights,) to begin with: the last layer next to nothing."""
        parts = []
        for k, (width, next_width) in enumerate(self._shapes):
            size = (0.0, 1.0 / np.sqrt(width))[k == 0]
            parts.append(size * random.standard_normal(width * next_width))
        return np.concatenate(parts).astype(np.float32)

    def split(self, weights: Array) -> list[Array]:
        """(networks, in, out) and (networks, 1, out) of each layer."""
        parts, begin = [], 0
        for shape in self._shapes:
            size = shape[0] * shape[1]
            parts.append(weights[:, begin : begin + size].reshape(-1, *shape))
            begin += size
        return parts

    def layers(self, weights: Array) -> training.Layers:
        """Those of one network, as a policy's file holds them."""
        parts = [part[0] for part in self.split(weights[None])]
        return [(w.T.copy(), b[0].copy()) for w, b in zip(parts[::2], parts[1::2], strict=True)]

    def act(self, weights: Array) -> optimum.Act:
        """What all networks do, each for its cars."""
        parts, args = self.split(weights), self._args
        held: dict[str, Any] = {}

        def raw(seen: Array) -> Array:
            x = seen.reshape(len(weights), -1, seen.shape[1])
            hidden = np.tanh(np.matmul(x, parts[0]) + parts[1])
            found: Array = (np.matmul(hidden, parts[2]) + parts[3]).reshape(len(seen), -1)
            return found

        def act(observation: Array, step: int) -> Array:
            if step % args.hold == 0:
                if step == 0:
                    held["seen"] = np.tile(observation, args.history)
                else:
                    held["seen"] = np.hstack((observation, held["seen"][:, : -self._entries]))
                seen = held["seen"]
                action = raw(seen) if self._mirror is None else 0.5 * (raw(seen) - raw(seen * self._mirror))
                held["action"] = np.clip(action, -1.0, 1.0)
            actions: Array = held["action"]
            return actions

        return act


class Search:
    """The mean of the networks, and Adam's moments."""

    def __init__(self, args: Args, networks: Networks) -> None:
        self.random = np.random.default_rng(args.seed)
        self.mean = networks.first(self.random)
        self.moment, self.square = np.zeros_like(self.mean), np.zeros_like(self.mean)
        self.iterations = 0

    def drawn(self, args: Args) -> Array:
        """(networks, weights): pairs, one above the mean and one below it."""
        noise = self.random.standard_normal((args.pairs, len(self.mean))).astype(np.float32)
        self.noise = np.concatenate((noise, -noise))
        return self.mean + np.float32(args.deviation) * self.noise

    def learn(self, args: Args, fitness: NDArray[np.float64], rate: float) -> None:
        """Move the mean along the slope of the ranks, which no outlier disturbs, by Adam."""
        ranks = np.argsort(np.argsort(fitness)) / (len(fitness) - 1.0) - 0.5
        slope = (ranks.astype(np.float32) @ self.noise) / (len(fitness) * args.deviation)
        self.iterations += 1
        self.moment = 0.9 * self.moment + 0.1 * slope
        self.square = 0.999 * self.square + 0.001 * slope * slope
        moment, square = self.moment / (1.0 - 0.9**self.iterations), self.square / (1.0 - 0.999**self.iterations)
        self.mean = (self.mean + rate * moment / (np.sqrt(square) + 1e-8)).astype(np.float32)

    def state(self) -> state_arrays.State:
        """All that the next iteration depends on."""
        return {
            "mean": self.mean.copy(),
            "moment": self.moment.copy(),
            "square": self.square.copy(),
            "iterations": np.array([self.iterations], np.int64),
            "random": generators.rows([self.random.bit_generator.state]),
        }

    def put(self, arrays: state_arrays.Arrays) -> None:
        """Put back what :meth:`state` gave; UserError for what it cannot have given."""
        try:
            self.mean = arrays.take("mean", np.float32, len(self.mean))
            self.moment = arrays.take("moment", np.float32, len(self.mean))
            self.square = arrays.take("square", np.float32, len(self.mean))
            (self.iterations,) = arrays.take("iterations", np.int64, 1).tolist()
            (self.random.bit_generator.state,) = generators.from_rows(arrays.take("random", np.uint64, 1, 6))
            arrays.end()
        except ValueError as error:
            raise training.damaged(error) from None


def train(args: Args, console: Console, watch: training.Watch | None = None) -> Path:
    """Search as the arguments say; gives the run's folder. `watch` sees each point of the learning curve."""
    keywords = parse_keywords(args.env_keywords)
    chosen = settings.own(args, ALGORITHM)
    path = args.out or Path("runs") / f"{args.env_id}-{ALGORITHM}-{args.seed}"
    messages.check_folder("--out", path)
    make_env(args.env_id, keywords).close()  # mistakes in the keywords are found here
    cars, assessed = optimum.Cars(args.env_id, keywords), optimum.Cars(args.env_id, keywords)
    networks = Networks(args, cars.plant)
    search = Search(args, networks)
    steps = 2 * args.pairs * args.starts * cars.episode_steps
    plan = training.Plan(args.env_id, keywords, ALGORITHM, args.seed, chosen, args.total_timesteps)
    manner = training.manner(args, cars.plant)
    with training.run_in(path, plan, assessed, manner, args.resume, console, args.quiet) as (run, arrays):
        run.watch = watch
        if arrays is not None:
            search.put(arrays)
        while (done := run.timesteps / args.total_timesteps) < 1.0:
            starts = start_seeds(args.starts, args.seed + 1000 * (search.iterations + 1), "tune")
            weights = search.drawn(args)
            outcomes = optimum.drive(cars.of(len(weights) * len(starts)), networks.act(weights), starts * len(weights))
            paid = outcomes.success + outcomes.episode_return / cars.episode_steps
            search.learn(args, paid.reshape(len(weights), -1).mean(axis=1), args.learning_rate * (1.0 - done))
            run.after_update(
                run.timesteps + steps,
                lambda: run.network(networks.layers(search.mean)),
                search.state,
                bool(np.all(np.isfinite(search.mean))),
            )
        run.finish(console)
    return path


def main() -> None:
    stopping.handle(stopping.leave_at_once)
    args = tyro.cli(
        Args, default=settings.usual(Args, ALGORITHM), prog="python -m agents.policy_search", description=__doc__
    )
    with announcements.silenced(args.quiet):
        train(args, messages.console())


if __name__ == "__main__":
    messages.run(main)
