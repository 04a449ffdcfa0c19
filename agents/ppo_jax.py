"""Proximal policy optimisation in JAX: a training is one pure function of a key, so that seeds train side by side.

    python -m agents.ppo_jax --env-id BicycleStab-v0 --seed 0 --out runs/stab-jax
    python -m agents.ppo_jax --env-id BicycleStab-v0 --seeds 10 --out runs/stab-jax   # ten seeds by vmap, a folder each

The algorithm is that of agents.ppo without what is particular there: no history, no imitation, a critic that sees what
the policy sees. The environment is `bicycle_env.envs.JaxEnv`, which steps on the device that the networks are on. On a
CPU the native environment of agents.ppo steps several times faster; this is for GPUs, for many seeds at once, and for
research that takes gradients through the car. Compiling takes some ten seconds, less with JAX_COMPILATION_CACHE_DIR.

The folder holds what agents.train writes: policy.safetensors and policy.json, run.json, curve.csv, checkpoint/.
Needs the extra [jax].
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import tyro
from rich.console import Console

import bicycle_env  # noqa: F401  (registers the environments)
from agents import messages, settings, stopping, training
from agents.evaluate import make_env, parse_keywords
from agents.messages import UserError
from agents.state_arrays import Arrays, State
from bicycle_env import optimum
from bicycle_env.backends import announcements
from bicycle_env.envs import JaxEnv
from bicycle_env.installation import needs

ALGORITHM = "jax-ppo"
Array = Any


@dataclass
class Args:
    """Train policies with PPO in JAX; what is not given is as agents/configs says for the id."""

    env_id: str = "BicycleStab-v0"
    """Environment id."""
    env_keywords: str = "{}"
    """Keywords of the environment as JSON, for example '{"level": "hard"}'."""
    seed: int = 0
    """Seed of networks, exploration and starts; with --seeds, of the first."""
    seeds: int = 1
    """How many are trained side by side, from `seed` on."""
    out: Path | None = None
    """Folder of the run, with --seeds of the runs' folders; by default runs/ENV_ID-jax-ppo-SEED."""
    resume: bool = False
    """Go on from the last checkpoint in the folder."""
    quiet: bool = False
    """No progress, and no word about what compiles."""

    total_timesteps: int = 3_000_000
    """Control steps of all cars together; rounded up to whole updates."""
    cars: int = 512
    """Driven at once, of each seed."""
    decisions: int = 32
    """Of each car between two updates."""
    hold: int = 1
    """Control steps for which an action is held."""
    epochs: int = 5
    """Passes over what was driven, in each update."""
    minibatches: int = 8
    """In each pass; cars times decisions must be a multiple of it."""
    learning_rate: float = 1e-3
    """Of Adam, at first; it falls to 0."""
    gamma: tuple[float, float] = (0.98, 0.995)
    """What the reward one decision later is worth: at first, and at the end."""
    gae_lambda: float = 0.95
    """Of generalised advantage estimation (arXiv:1506.02438)."""
    clip: float = 0.2
    """How far the probability of an action may move in an update, as a share of what it was."""
    entropy: float = 0.0
    """Weight of the entropy."""
    reward_scale: float = 0.1
    """The critic learns returns of this times the reward."""
    width: int = 64
    """Of the two hidden layers of policy and critic."""
    deviation: float = 0.37
    """Of the actions that are tried out at first, as a share of full steer."""
    mirrored: bool = True
    """Mirror images are answered by mirror images."""
    history: ClassVar[int] = 1
    """No option: what a policy's file says."""


class Learner(NamedTuple):
    """All that a training changes: a pytree of arrays."""

    weights: dict[str, Any]
    """"policy" and "critic", lists of (weight (out, in), bias (out,)), and "log_deviation" (axles,)."""
    adam: Any
    cars: Any
    """The states of the cars."""
    seen: Array
    """(cars, entries), what they observe."""
    key: Array
    update: Array
    """How many there were."""


class Driven(NamedTuple):
    """Of each decision, (decisions, cars, ...)."""

    seen: Array
    action: Array
    log_chance: Array
    reward: Array
    terminated: Array
    over: Array
    """Ended either way."""
    value: Array
    next_value: Array
    """Of what was observed after the decision, before a new start."""


def advantages(driven: Any, gamma: Array, gae_lambda: float) -> Array:
    """Generalised advantage estimation, (decisions, cars): A_t = d_t + gamma lambda A_{t+1} within an episode.

    d_t = r_t + gamma V_{t+1} - V_t; nothing comes after an end, but for what a time-out leaves open.
    """
    import jax

    surprise = driven.reward + gamma * driven.next_value * ~driven.terminated - driven.value

    def earlier(coming: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        found = now[0] + gamma * gae_lambda * ~now[1] * coming
        return found, found

    _, found = jax.lax.scan(earlier, 0.0 * surprise[0], (surprise, driven.over), reverse=True)
    return found


def trainer(args: Args, env: JaxEnv) -> tuple[Callable[[Array], Learner], Callable[[Learner], Learner]]:
    """``begin(key) -> Learner`` and ``update(Learner) -> Learner``, pure: to be compiled, scanned and mapped over."""
    jax, optax = importlib.import_module("jax"), importlib.import_module("optax")
    jnp = jax.numpy
    entries, axles = env.observation_space.shape[0], env.action_space.shape[0]
    mirror = jnp.asarray(env.observation_mirror, jnp.float32) if args.mirrored else None
    adam = optax.chain(optax.clip_by_global_norm(0.5), optax.scale_by_adam(eps=1e-5))
    steps = args.cars * args.decisions * env.action_repeat
    reset, step = jax.vmap(env.reset), jax.vmap(env.step)

    def layers(key: Array, sizes: list[int], last_gain: float) -> list[tuple[Array, Array]]:
        keys, pairs = jax.random.split(key, len(sizes) - 1), list(itertools.pairwise(sizes))
        gains = [math.sqrt(2.0)] * (len(pairs) - 1) + [last_gain]
        start = jax.nn.initializers.orthogonal
        return [
            (start(gain)(one, (out, into), jnp.float32), jnp.zeros(out, jnp.float32))
            for one, gain, (into, out) in zip(keys, gains, pairs, strict=True)
        ]

    def perceptron(network: list[tuple[Array, Array]], x: Array) -> Array:
        for weight, bias in network[:-1]:
            x = jnp.tanh(x @ weight.T + bias)
        weight, bias = network[-1]
        return x @ weight.T + bias

    def mirrored(network: list[tuple[Array, Array]], x: Array, sign: float) -> Array:
        """Odd (-1) or even (+1) under a mirror image."""
        found = perceptron(network, x)
        return found if mirror is None else 0.5 * (found + sign * perceptron(network, x * mirror))

    def worth(weights: dict[str, Any], seen: Array) -> Array:
        return mirrored(weights["critic"], seen, 1.0)[..., 0]

    def log_chance(weights: dict[str, Any], seen: Array, action: Array) -> Array:
        deviation = weights["log_deviation"]
        z = (action - mirrored(weights["policy"], seen, -1.0)) / jnp.exp(deviation)
        return jnp.sum(-0.5 * z * z - deviation - 0.5 * math.log(2.0 * math.pi), axis=-1)

    def begin(key: Array) -> Learner:
        key, of_policy, of_critic, of_cars = jax.random.split(key, 4)
        weights = {
            "policy": layers(of_policy, [entries, args.width, args.width, axles], 0.01),
            "critic": layers(of_critic, [entries, args.width, args.width, 1], 1.0),
            "log_deviation": jnp.full(axles, math.log(args.deviation), jnp.float32),
        }
        seen, cars = reset(jax.random.split(of_cars, args.cars))
        return Learner(weights, adam.init(weights), cars, seen, key, jnp.zeros((), jnp.int32))

    def drive(learner: Learner, key: Array) -> tuple[Any, Driven]:
        weights = learner.weights

        def decide(now: tuple[Any, Array], key: Array) -> tuple[tuple[Any, Array], Driven]:
            (cars, seen), (noise, of_cars) = now, jax.random.split(key)
            chance = jax.random.normal(noise, (args.cars, axles), jnp.float32)
            action = mirrored(weights["policy"], seen, -1.0) + jnp.exp(weights["log_deviation"]) * chance
            after = step(jax.random.split(of_cars, args.cars), cars, jnp.clip(action, -1.0, 1.0))
            observation, cars, reward, terminated, truncated, info = after
            gained = (args.reward_scale * reward).astype(jnp.float32)
            values = worth(weights, seen), worth(weights, info["final_observation"])
            chances = log_chance(weights, seen, action)
            return (cars, observation), Driven(
                seen, action, chances, gained, terminated, terminated | truncated, *values
            )

        keys = jax.random.split(key, args.decisions)
        driven: tuple[Any, Driven] = jax.lax.scan(decide, (learner.cars, learner.seen), keys)
        return driven

    def loss(weights: dict[str, Any], some: dict[str, Array]) -> Array:
        ratio = jnp.exp(log_chance(weights, some["seen"], some["action"]) - some["log_chance"])
        near = jnp.clip(ratio, 1.0 - args.clip, 1.0 + args.clip)
        better = jnp.mean(jnp.minimum(ratio * some["advantage"], near * some["advantage"]))
        missed = jnp.mean((worth(weights, some["seen"]) - some["target"]) ** 2)
        entropy = jnp.sum(weights["log_deviation"]) + 0.5 * axles * math.log(2.0 * math.pi * math.e)
        return 0.5 * missed - better - args.entropy * entropy

    def update(learner: Learner) -> Learner:
        key, of_driving, of_order = jax.random.split(learner.key, 3)
        done = learner.update * (steps / args.total_timesteps)
        gamma = (args.gamma[0] + (args.gamma[1] - args.gamma[0]) * done).astype(jnp.float32)
        rate = (args.learning_rate * jnp.maximum(1.0 - done, 0.0)).astype(jnp.float32)
        (cars, seen), driven = drive(learner, of_driving)
        gained = advantages(driven, gamma, args.gae_lambda)
        batch = {
            "seen": driven.seen,
            "action": driven.action,
            "log_chance": driven.log_chance,
            "advantage": (gained - jnp.mean(gained)) / (jnp.std(gained) + 1e-8),
            "target": gained + driven.value,
        }
        rows = args.cars * args.decisions
        batch = {name: values.reshape(rows, *values.shape[2:]) for name, values in batch.items()}

        def gradient_step(now: tuple[Any, Any], chosen: Array) -> tuple[tuple[Any, Any], None]:
            weights, moments = now
            slope = jax.grad(loss)(weights, {name: values[chosen] for name, values in batch.items()})
            change, moments = adam.update(slope, moments)
            return (jax.tree.map(lambda weight, by: weight - rate * by, weights, change), moments), None

        def epoch(now: tuple[Any, Any], key: Array) -> tuple[tuple[Any, Any], None]:
            order = jax.random.permutation(key, rows).reshape(args.minibatches, -1)
            return jax.lax.scan(gradient_step, now, order)

        learned = jax.lax.scan(epoch, (learner.weights, learner.adam), jax.random.split(of_order, args.epochs))[0]
        return Learner(*learned, cars, seen, key, learner.update + 1)

    return begin, update


def train(args: Args, console: Console, watch: training.Watch | None = None) -> list[Path]:
    """Train as the arguments say; gives the runs' folders. `watch` sees each point of the first learning curve."""
    jax = imported()
    keywords = parse_keywords(args.env_keywords)
    messages.check_least(args, seeds=1)
    if args.cars * args.decisions % args.minibatches:
        raise UserError(
            f"--minibatches must divide --cars times --decisions, {args.cars * args.decisions}, got {args.minibatches}"
        )
    chosen = settings.own(args, ALGORITHM)
    seeds = range(args.seed, args.seed + args.seeds)
    usual = Path("runs") / f"{args.env_id}-{ALGORITHM}-{args.seed}"
    out = args.out or usual
    paths = [out] if args.seeds == 1 else [out / str(seed) for seed in seeds]
    messages.check_folder("--out", out)
    make_env(args.env_id, keywords).close()  # mistakes in the keywords are found here
    held = {**keywords, "action_repeat": args.hold * keywords.get("action_repeat", 1)}
    env, assessed = JaxEnv(args.env_id, **held), optimum.Cars(args.env_id, keywords)
    manner = training.manner(args, assessed.plant)
    begin, update = (jax.vmap(law) for law in trainer(args, env))
    steps = args.cars * args.decisions * env.action_repeat
    updates = math.ceil(args.total_timesteps / steps)
    every = max(1, updates // training.ASSESSMENTS)

    @jax.jit
    def some(learners: Learner) -> Learner:
        return jax.lax.fori_loop(0, every, lambda _, now: update(now), learners)

    learners: Learner = jax.jit(begin)(np.stack([np.asarray(jax.random.PRNGKey(seed)) for seed in seeds]))
    with contextlib.ExitStack() as stack:
        opened = []
        for seed, path in zip(seeds, paths, strict=True):
            plan = training.Plan(args.env_id, keywords, ALGORITHM, seed, chosen, args.total_timesteps)
            quiet = args.quiet or seed != args.seed
            opened.append(
                stack.enter_context(training.run_in(path, plan, assessed, manner, args.resume, console, quiet))
            )
        runs = [run for run, _ in opened]
        runs[0].watch = watch
        if args.resume and all(arrays is not None for _, arrays in opened):
            learners = put([arrays for _, arrays in opened if arrays is not None], learners, jax)
        if len(places := {run.timesteps for run in runs}) > 1:
            raise UserError(
                f"--resume: the seeds were killed at different steps, {', '.join(map(str, sorted(places)))}; go on "
                "with each by itself: --seed and the folder of its own as --out"
            )
        while runs[0].timesteps < args.total_timesteps:
            learners = jax.block_until_ready(some(learners))
            stopped, states = None, []
            for k, run in enumerate(runs):
                mine = jax.tree.map(lambda column, k=k: np.asarray(column[k]), learners)
                finite = all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(mine.weights))
                states.append(lambda mine=mine: state(mine, jax))
                try:
                    run.after_update(
                        run.timesteps + every * steps,
                        lambda mine=mine, run=run: run.network(mine.weights["policy"]),
                        states[k],
                        finite,
                    )
                except stopping.Stopped as signal:  # which one of them hears; they go on together
                    stopped = signal
            if stopped is not None:
                for run, give in zip(runs, states, strict=True):
                    run.checkpoint(give)
                raise stopped
        for run in runs:
            run.finish(console)
    return paths


def imported() -> Any:
    """JAX with 64 bits, in which noise is counted; UserError if a package is missing."""
    for name in ("jax", "optax"):
        try:
            importlib.import_module(name)
        except ModuleNotFoundError:
            raise UserError(needs("agents.ppo_jax", name, "jax")) from None
    jax = importlib.import_module("jax")
    jax.config.update("jax_enable_x64", True)
    return jax


def state(learner: Learner, jax: Any) -> State:
    """All that the next update depends on, by name."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(learner)
    return {jax.tree_util.keystr(path): np.array(leaf) for path, leaf in leaves}


def put(arrays: list[Arrays], learners: Learner, jax: Any) -> Learner:
    """What :func:`state` gave of each seed, side by side; UserError for what it cannot have given."""
    leaves, tree = jax.tree_util.tree_flatten_with_path(learners)
    try:
        found = [
            np.stack([one.take(jax.tree_util.keystr(path), leaf.dtype, *leaf.shape[1:]) for one in arrays])
            for path, leaf in leaves
        ]
        for one in arrays:
            one.end()
    except ValueError as error:
        raise training.damaged(error) from None
    learner: Learner = jax.tree_util.tree_unflatten(tree, found)
    return learner


def main() -> None:
    stopping.handle(stopping.leave_at_once)
    args = tyro.cli(Args, default=settings.usual(Args, ALGORITHM), prog="python -m agents.ppo_jax", description=__doc__)
    with announcements.silenced(args.quiet):
        train(args, messages.console())


if __name__ == "__main__":
    messages.run(main)
