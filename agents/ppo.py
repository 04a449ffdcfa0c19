"""Proximal policy optimisation (J. Schulman et al., arXiv:1707.06347): the whole algorithm, top to bottom.

    python -m agents.ppo --env-id BicycleStab-v0 --seed 0 --out runs/stab

Hundreds of cars are driven at once by the native vector environment, in one thread. What is particular here:

- A time-out is no end: the value of what is observed there stands for what would come (unless a bonus is paid for it).
- An action may be held for several control steps, or the noise on it. At 50 Hz a road wheel, which turns at a limited
  rate, averages the noise of an action away, so that nothing is tried out.
- The policy may see what it saw at its last decisions; the critic also sees what is hidden.
- An episode in which success can no longer come may end there: else a policy learns to fail one criterion for sure, in
  order not to fail two.
- It may begin as the image of a classical controller, or of one that has learned to plan; or be added to a controller's
  actions.
- A mirror image is answered by the mirror image of the action, and worth as much.
- Each car may have a speed of its own: what is learned slow helps where it is fast.
- The best policy is kept, chosen on starts of their own, not the last one.

Holding and remembering belong to the policy, whose file says so: it drives the environment that all others drive. The
folder holds what agents.train writes: policy.safetensors and policy.json, run.json, curve.csv, checkpoint/.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from rich.console import Console
from torch import Tensor, nn
from torch.distributions import Normal

import bicycle_env  # noqa: F401  (registers the environments)
from agents import imitation, messages, residual, settings, speeds, state_arrays, stopping, training
from agents.evaluate import make_env, make_vector_env, parse_keywords
from bicycle_env import optimum
from bicycle_env.backends import announcements

ALGORITHM = "native-ppo"


@dataclass
class Args:
    """Train a policy with PPO; what is not given is as agents/configs says for the id."""

    env_id: str = "BicycleStab-v0"
    """Environment id."""
    env_keywords: str = "{}"
    """Keywords of the environment as JSON, for example '{"level": "hard"}'."""
    seed: int = 0
    """Seed of networks, exploration and starts."""
    out: Path | None = None
    """Folder of the run; by default runs/ENV_ID-native-ppo-SEED."""
    resume: bool = False
    """Go on from the last checkpoint in the folder."""
    quiet: bool = False
    """No progress, and no word about what compiles."""

    total_timesteps: int = 3_000_000
    """Control steps of all cars together, resets counted; rounded up to whole updates."""
    cars: int = 512
    """Driven at once."""
    decisions: int = 32
    """Of each car between two updates."""
    hold: int = 1
    """Control steps for which an action is held."""
    history: int = 1
    """How many observations the policy sees: those of its last decisions."""
    epochs: int = 5
    """Passes over what was driven, in each update."""
    minibatch: int = 2048
    """Decisions in a gradient step."""
    learning_rate: float = 1e-3
    """Of Adam, at first; it falls to 0."""
    gamma: tuple[float, float] = (0.98, 0.995)
    """What the reward one decision later is worth: at first, and at the end, when the critic can see further. Within a
    decision nothing is discounted, so that a held action looks further in seconds."""
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
    noise_hold: int = 1
    """Decisions for which the noise on the policy's action stays the same, where one is too short for the wheels."""
    mirrored: bool = True
    """Mirror images are answered by mirror images."""
    informed_critic: bool = True
    """The critic sees the whole state of the car and what the task hides."""
    end_forfeited: bool = True
    """An episode in which success can no longer come ends there, in training only."""
    success_bonus: float = 0.0
    """Added to the reward where the time is over with success, in training only; a time-out is then an end."""
    speeds: tuple[float, ...] = ()
    """From which to which the cars drive, m/s, evenly spread, those too that choose the best policy; else all as the
    keywords say."""
    imitate: str = ""
    """A controller by name: the policy begins as its image, with the parameters tuned for the id and level."""
    plan: int = 0
    """Iterations of a search that first lets this controller choose its path by what the start shows; of evade-path."""
    residual: str = ""
    """A controller by name, with the parameters tuned for the id and level: what is learned is added to its actions."""
    critic_alone: int = 0
    """Updates at first in which only the critic learns: a policy that is good already must not unlearn."""


class Mirrored(nn.Module):
    """A multilayer perceptron with tanh, made odd (`sign` -1) or even (+1) under a mirror image; None: as it is."""

    def __init__(self, sizes: list[int], last_gain: float, mirror: Tensor | None, sign: float) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for k, (width, next_width) in enumerate(itertools.pairwise(sizes)):
            layer = nn.Linear(width, next_width)
            nn.init.orthogonal_(layer.weight, last_gain if k == len(sizes) - 2 else math.sqrt(2.0))
            nn.init.zeros_(layer.bias)
            layers += [layer, nn.Tanh()]
        self.layers, self.mirror, self.sign = nn.Sequential(*layers[:-1]), mirror, sign

    def forward(self, x: Tensor) -> Tensor:
        found: Tensor = self.layers(x)
        return found if self.mirror is None else 0.5 * (found + self.sign * self.layers(x * self.mirror))


def advantages(rewards: Any, values: Any, terminated: Any, over: Any, gamma: float, gae_lambda: float) -> Any:
    """Generalised advantage estimation, (decisions, cars).

    A_t = d_t + gamma lambda A_{t+1} with d_t = r_t + gamma V_{t+1} - V_t.

    Args:
        rewards, terminated: (decisions, cars), of each decision.
        values: (decisions + 1, cars), of what is observed before each decision and after the last one. After an end it
            is that of the last observation of the episode: worth nothing where the episode terminated, and what would
            come where its time was over.
        over: (decisions, cars), whether the episode ended with the decision, either way.
    """
    found, coming = np.zeros_like(rewards), np.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        surprise = rewards[t] + gamma * values[t + 1] * ~terminated[t] - values[t]
        coming = surprise + gamma * gae_lambda * ~over[t] * coming
        found[t] = coming
    return found


class Cars:
    """The cars that are driven to learn from.

    Attributes: ``seen`` (cars, history * entries), the observations of the last decisions, the newest first; ``over``
    (cars,), whose episode has ended: their next step is their reset, from which nothing is learned; ``forfeited``
    (cars,), those of them that the environment would let go on.
    """

    def __init__(self, args: Args, keywords: dict[str, Any]) -> None:
        self._args = args
        if args.residual:
            law = residual.base(args.residual, make_env(args.env_id, keywords).unwrapped)
            self.env: Any = residual.OnTop(args.env_id, args.cars, keywords, law, args.hold)
        else:
            repeat = args.hold * keywords.get("action_repeat", 1)
            held = {**keywords, **speeds.own(args.speeds, args.cars), "action_repeat": repeat}
            self.env = make_vector_env(args.env_id, args.cars, held, "NextStep").unwrapped
        self.entries = self.env.single_observation_space.shape[0]
        self.axles = self.env.single_action_space.shape[0]
        self.mirror = np.tile(self.env.observation_mirror.astype(np.float32), args.history)
        task = self.env.task
        self._forfeits = task.forfeits if args.end_forfeited else ()
        moving = self.env.model.State._fields[1:]  # the place along the road says nothing
        self._hidden = (*moving, "time", *task.hidden)
        turned = (*moving, *(task.flipped or ()))
        self.hidden_mirror = np.array([-1.0 if name in turned else 1.0 for name in self._hidden], np.float32)

        self.over = self.forfeited = np.zeros(args.cars, np.bool_)
        self.seen = np.zeros((args.cars, len(self.mirror)), np.float32)

    def begin(self, seed: int, episode: int) -> None:
        """Start the cars in sixteen groups, with a sixteenth of an episode of straight steering from one to the next.

        So an update does not see all cars at the same moment of the episode.
        """
        groups, axles = min(16, self._args.cars), np.zeros((self._args.cars, self.axles), np.float32)
        self.env.reset(seed=seed)
        for group in range(groups):
            first, _ = self.env.reset(options={"reset_mask": np.arange(self._args.cars) % groups == group})
            for _ in range(max(1, episode // self.env.action_repeat // groups)):
                first, _, terminated, truncated, _ = self.env.step(axles)
        self.over = terminated | truncated
        self.seen = self._alone(first)

    def step(self, actions: Any) -> tuple[Any, Any]:
        """Rewards and who has terminated, (cars,) each."""
        # Gymnasium's NextStep: a car whose episode has ended is reset by its next step, which ignores the action. Cars
        # that have forfeited would drive on: reset here, they make one step with an action for the old episode. Neither
        # row is learned from (`ready` in drive). Clipped for the car alone: the policy is that of the unclipped action.
        if np.any(self.forfeited):
            self.env.reset(options={"reset_mask": self.forfeited})
        observation, rewards, terminated, truncated, _ = self.env.step(np.clip(actions, -1.0, 1.0))
        if self._args.success_bonus:
            rewards = rewards + self._args.success_bonus * (truncated & self.env.is_success)
            terminated = terminated | truncated
        if self._forfeits:
            state = self.env.state
            lost = np.any([getattr(state, name) > 0.5 for name in self._forfeits], axis=0)
            # Worth nothing from here on, and no penalty: to pass one criterion more is then always better.
            self.forfeited = lost & ~(terminated | truncated)
            terminated = terminated | self.forfeited
        earlier = np.hstack((observation, self.seen[:, : -self.entries]))
        self.seen = np.where(self.over[:, None], self._alone(observation), earlier)
        self.over = terminated | truncated
        return rewards, terminated

    def _alone(self, observation: Any) -> Any:
        """What is seen where nothing was before."""
        return np.tile(observation, self._args.history)

    def hidden(self) -> Any:
        """(cars, names), the state of each car and what the task hides, SI."""
        state = self.env.state
        return np.stack([getattr(state, name) for name in self._hidden], axis=1).astype(np.float32)


class Learner(nn.Module):
    """Policy and critic, and how both see."""

    def __init__(self, args: Args, cars: Cars) -> None:
        super().__init__()
        entries = cars.entries * args.history
        names = len(cars.hidden_mirror) if args.informed_critic else 0
        mirror = torch.from_numpy(cars.mirror) if args.mirrored else None
        both = torch.from_numpy(np.concatenate((cars.mirror, cars.hidden_mirror[:names]))) if args.mirrored else None
        self.policy = Mirrored([entries, args.width, args.width, cars.axles], 0.01, mirror, -1.0)
        self.critic = Mirrored([entries + names, args.width, args.width, 1], 1.0, both, 1.0)
        self.log_deviation = nn.Parameter(torch.full((cars.axles,), math.log(args.deviation)))
        # Of what is hidden, in SI; set by the first update and kept. What is observed is scaled by the environment.
        self.register_buffer("scale", torch.zeros(names))

    def actions(self, seen: Tensor) -> Normal:
        return Normal(self.policy(seen), self.log_deviation.exp(), validate_args=False)

    def worth(self, seen: Tensor, hidden: Tensor) -> Tensor:
        known = (hidden[:, : len(self.scale)] * self.scale).clamp(-10.0, 10.0)
        found: Tensor = self.critic(torch.cat((seen, known), dim=1)).squeeze(1)
        return found

    def layers(self) -> training.Layers:
        """Of the policy."""
        linear = [layer for layer in self.policy.layers if isinstance(layer, nn.Linear)]
        return [(layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in linear]

    def finite(self) -> bool:
        return all(bool(torch.isfinite(tensor).all()) for tensor in self.state_dict().values())


def drive(args: Args, learner: Learner, cars: Cars, gamma: float) -> dict[str, Tensor]:
    """Drive `decisions` decisions of every car; gives those that may be learned from, one row each."""
    rows: list[tuple[Any, ...]] = []
    seen, hidden, ready = [], [], []
    with torch.no_grad():
        for k in range(args.decisions):
            seen.append(torch.from_numpy(cars.seen)), hidden.append(torch.from_numpy(cars.hidden()))
            ready.append(torch.from_numpy(~cars.over))
            tried = learner.actions(seen[-1])
            if k % args.noise_hold == 0:
                noise = torch.randn_like(tried.mean)
            action = tried.mean + tried.stddev * noise
            reward, terminated = cars.step(action.numpy())
            rows.append((action, tried.log_prob(action).sum(1), reward, terminated, cars.over))
        seen.append(torch.from_numpy(cars.seen)), hidden.append(torch.from_numpy(cars.hidden()))
        if not torch.any(learner.scale):
            learner.scale.copy_(1.0 / (torch.cat(hidden)[:, : len(learner.scale)].square().mean(0).sqrt() + 1e-6))
        values = torch.stack([learner.worth(*pair) for pair in zip(seen, hidden, strict=True)]).numpy()
    actions, chances, rewards, terminated, over = zip(*rows, strict=True)
    scaled = args.reward_scale * np.stack(rewards).astype(np.float32)
    gained = torch.from_numpy(advantages(scaled, values, np.stack(terminated), np.stack(over), gamma, args.gae_lambda))
    chosen = torch.stack(ready)
    return {
        "seen": torch.stack(seen[:-1])[chosen],
        "hidden": torch.stack(hidden[:-1])[chosen],
        "action": torch.stack(actions)[chosen],
        "log_chance": torch.stack(chances)[chosen],
        "advantage": gained[chosen],
        "target": (gained + torch.from_numpy(values[:-1]))[chosen],
    }


def learn(
    args: Args, learner: Learner, optimizer: torch.optim.Optimizer, driven: dict[str, Tensor], critic_alone: bool
) -> None:
    """Some passes over what was driven."""
    gained = driven["advantage"]  # of the whole batch: mean 0, deviation 1
    driven["advantage"] = (gained - gained.mean()) / (gained.std() + 1e-8)
    for _ in range(args.epochs):
        for rows in torch.randperm(len(gained)).tensor_split(max(1, len(gained) // args.minibatch)):
            some = {name: values[rows] for name, values in driven.items()}
            tried = learner.actions(some["seen"])
            # How much likelier the action is now; the clipped surrogate; half of the critic's squared error, as usual.
            ratio = (tried.log_prob(some["action"]).sum(1) - some["log_chance"]).exp()
            near = ratio.clamp(1.0 - args.clip, 1.0 + args.clip)
            better = torch.minimum(ratio * some["advantage"], near * some["advantage"]).mean()
            missed = (learner.worth(some["seen"], some["hidden"]) - some["target"]).square().mean()
            loss = 0.5 * missed
            if not critic_alone:
                loss = loss - better - args.entropy * tried.entropy().sum(1).mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(learner.parameters(), 0.5)
            optimizer.step()


def train(args: Args, console: Console, watch: training.Watch | None = None) -> Path:
    """Train as the arguments say; gives the run's folder. `watch` sees each point of the learning curve."""
    keywords = parse_keywords(args.env_keywords)
    chosen = settings.own(args, ALGORITHM)
    speeds.check(args, keywords)
    residual.check(args)
    path = args.out or Path("runs") / f"{args.env_id}-{ALGORITHM}-{args.seed}"
    messages.check_folder("--out", path)
    make_env(args.env_id, keywords).close()  # mistakes in the keywords are found here
    torch.set_num_threads(1)  # small networks: more threads only wait for each other
    torch.manual_seed(args.seed)
    assessed = optimum.Cars(args.env_id, keywords, lambda count: speeds.own(args.speeds, count))
    cars = Cars(args, keywords)
    learner = Learner(args, cars)
    optimizer = torch.optim.Adam(learner.parameters(), args.learning_rate, eps=1e-5)
    plan = training.Plan(args.env_id, keywords, ALGORITHM, args.seed, chosen, args.total_timesteps)
    manner = training.manner(args, assessed.plant) | residual.manner(args.residual, assessed.plant)
    with training.run_in(path, plan, assessed, manner, args.resume, console, args.quiet) as (run, arrays):
        run.watch = watch
        if arrays is None:
            if args.imitate:
                imitation.begin(learner.policy, args, keywords, assessed)
            cars.begin(args.seed, assessed.episode_steps)
        else:
            put(arrays, learner, optimizer, cars)
        steps = args.cars * args.decisions * cars.env.action_repeat
        while (done := run.timesteps / args.total_timesteps) < 1.0:
            optimizer.param_groups[0]["lr"] = args.learning_rate * (1.0 - done)
            gamma = args.gamma[0] + (args.gamma[1] - args.gamma[0]) * done
            driven = drive(args, learner, cars, gamma)
            learn(args, learner, optimizer, driven, critic_alone=run.timesteps < args.critic_alone * steps)
            run.after_update(
                run.timesteps + steps,
                lambda: run.network(learner.layers()),
                lambda: state(learner, optimizer, cars),
                learner.finite(),
            )
        run.finish(console)
    return path


def state(learner: Learner, optimizer: torch.optim.Optimizer, cars: Cars) -> state_arrays.State:
    """All that the next update depends on."""
    return {
        **state_arrays.of_tensors(learner.state_dict()),
        **state_arrays.of_adam("adam", optimizer),
        **state_arrays.of_process(),
        **state_arrays.of_cars(cars.env.snapshot()),
        **residual.state(cars.env),
        "seen": cars.seen.copy(),
        "over": cars.over.copy(),
        "forfeited": cars.forfeited.copy(),
    }


def put(arrays: state_arrays.Arrays, learner: Learner, optimizer: torch.optim.Optimizer, cars: Cars) -> None:
    """Put back what :func:`state` gave; UserError for what it cannot have given."""
    try:
        state_arrays.put_tensors(learner.state_dict(), arrays)
        state_arrays.put_adam("adam", optimizer, arrays)
        seen = state_arrays.put_cars(cars.env, cars.env.dtype, len(cars.over), arrays)
        residual.put(cars.env, arrays, seen)
        cars.seen = arrays.take("seen", np.float32, *cars.seen.shape)
        cars.over = arrays.take("over", np.bool_, *cars.over.shape)
        cars.forfeited = arrays.take("forfeited", np.bool_, *cars.forfeited.shape)
        state_arrays.put_process(arrays)
        arrays.end()
    except ValueError as error:
        raise training.damaged(error) from None


def main() -> None:
    stopping.handle(stopping.leave_at_once)
    args = tyro.cli(Args, default=settings.usual(Args, ALGORITHM), prog="python -m agents.ppo", description=__doc__)
    with announcements.silenced(args.quiet):
        train(args, messages.console())


if __name__ == "__main__":
    messages.run(main)
