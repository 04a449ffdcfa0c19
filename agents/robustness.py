"""How much a policy bears: success on other cars, roads and signals than its own, and its margins at straight running.

    python -m agents.robustness --env-id BicycleStab-v0 --policy pretrained lqr
    python -m agents.robustness --env-id BicycleActiveSteer-v0 --level hard --policy pretrained classical

Every policy is made for the nominal environment and then drives others, one quantity changed at a time, from the same
starts: mass, yaw inertia, cornering stiffness and speed, friction, a delay of the action, noise on what is observed.
Where a policy acts on the present observation alone, which shows the car's states (BicycleStab-v0), its Jacobian at
straight running gives closed-loop eigenvalues, gain and phase margins of each axle, as of a linear controller; a policy
that is not odd there, or not stable, is named. Written: runs/robustness-ENV_ID-LEVEL.json and .png.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray

from agents import messages
from agents.episodes import start_seeds
from agents.evaluate import make_env, named, parse_keywords
from agents.messages import UserError
from agents.statistics import mean, share
from bicycle_env import Sensors, distributions, files, optimum, provenance
from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.control import Policy
from bicycle_env.control.design.margins import Loop, margins
from bicycle_env.plots.style import dress, line_style, new_figure, save
from bicycle_env.tasks import AlteredTask

FACTORS = {
    "mass": (0.8, 0.9, 1.0, 1.1, 1.2, 1.3),
    "yaw_inertia": (0.8, 0.9, 1.0, 1.1, 1.2, 1.3),
    "stiffness": (0.8, 0.9, 1.0, 1.1, 1.2),
    "speed": (0.9, 0.95, 1.0, 1.05, 1.1),
    "friction": (0.5, 0.7, 0.85, 1.0, 1.15),
}
"""Per the nominal value."""
DELAYS = (0, 1, 2, 3, 4, 6)
"""Control steps that an action arrives late."""
NOISE = (0.0, 0.005, 0.01, 0.02, 0.04)
"""rad/s, standard deviation of the observed yaw rate."""
UNITS = {"action_delay": "control steps more", "noise": "rad/s on the yaw rate"}
STEP = 1e-3
"""Of an entry of the observation, for the Jacobian."""
MOST_DELAY = 50
"""Control steps of delay that are tried, for the largest that leaves straight running stable."""
ODD = 1e-3
"""Difference from an odd policy, of full steer, that is named."""


@dataclass
class Args:
    """Drive policies on changed cars, roads and signals; figures, a picture, and margins at straight running."""

    env_id: str = "BicycleStab-v0"
    """Environment id."""
    policy: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME|FOLDER [...]")] = ("pretrained", "lqr")
    """As for agents.evaluate; "classical" is the best classical controller, tuned for the level, of
    results/headroom.json."""
    level: str | None = None
    """Of the nominal environment: easy, medium or hard."""
    env_keywords: str = "{}"
    """Further keywords of the nominal environment as JSON."""
    starts: int = 500
    """Of each point, the same for all; the first of those that report."""
    seed: int = 1
    """Seed of these starts."""
    json: Path | None = None
    """Where the figures go, the picture beside them; by default runs/robustness-ENV_ID-LEVEL.json, of an
    environment of no level runs/robustness-ENV_ID.json."""


def stated(plant: Any, keywords: Mapping[str, Any]) -> dict[str, Any]:
    """What the level says and what the keywords say."""
    task = plant.task
    while isinstance(task, AlteredTask):
        task = task.task
    return {**task.levels.get(plant.level, {}), **keywords}


def changed(plant: Any, quantity: str, value: float, keywords: Mapping[str, Any] = MappingProxyType({})) -> Any:
    """Keywords of the environment in which a quantity is another than these say."""
    car, speed = plant.vehicle, plant.speed
    if quantity == "action_delay":
        return {"action_delay": keywords.get("action_delay", 0) + int(value)}
    if quantity == "noise":
        return {"sensors": Sensors(noise={"yaw_rate": value})} if value else {}
    if quantity == "speed":
        return {"speed": value * speed}
    names = ("front_cornering_stiffness", "rear_cornering_stiffness") if quantity == "stiffness" else (quantity,)
    drawn = scaled(keywords.get("randomise") or {}, names, value)
    if quantity == "friction":
        return {"friction": value * plant.friction, **drawn}
    return {"vehicle": replace(car, **{name: value * getattr(car, name) for name in names}), "speed": speed, **drawn}


def scaled(randomise: Mapping[str, Any], names: Sequence[str], factor: float) -> dict[str, Any]:
    """The keyword for what is drawn for each episode, where these are drawn as numbers of their own and not per the
    nominal one; else nothing, as they follow that."""
    found = {}
    for name in {*names} & {*randomise}:
        chosen: Any = distributions.resolve(f"randomise[{name!r}]", randomise[name])
        if not chosen.relative:
            numbers = {one.name: getattr(chosen, one.name) for one in fields(chosen) if one.init}
            del numbers["relative"]
            found[name] = replace(chosen, **{key: (factor * np.array(one)).tolist() for key, one in numbers.items()})
    return {"randomise": {**randomise, **found}} if found else {}


def points(keywords: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """What is changed, and to which values; not what the environment itself sets."""
    every = {**FACTORS, "action_delay": tuple(map(float, DELAYS)), "noise": NOISE}
    own = {"noise"} if "sensors" in keywords else set()
    return {name: values for name, values in every.items() if name not in own}


def card(env_id: str, keywords: Mapping[str, Any], policies: Mapping[str, Policy], starts: list[int], bar: Any) -> Any:
    """By quantity the values, and of each policy success and return there."""
    plant = optimum.Cars(env_id, keywords).plant
    own = stated(plant, keywords)
    wanted = points(own)
    job = bar.add_task("driving", total=sum(map(len, wanted.values())))
    found: dict[str, Any] = {}
    for quantity, values in wanted.items():
        rows: dict[str, list[Any]] = {name: [] for name in policies}
        for value in values:
            given = changed(plant, quantity, value, own)
            kept = {name: one for name, one in keywords.items() if name not in ("speed_ratio", *given)}
            cars = optimum.Cars(env_id, {**kept, **given}).of(len(starts))
            for name, policy in policies.items():
                driven = optimum.drive(cars, optimum.by(policy), starts)
                figures = {"success_rate": share(driven.success), "episode_return": mean(driven.episode_return)}
                rows[name].append(figures)
            bar.advance(job)
        found[quantity] = {"values": list(values), "policies": rows}
    return found


def jacobian(policy: Policy, entries: int) -> NDArray[np.float64]:
    """(axles, entries), by central differences about straight running."""
    plus = np.eye(entries, dtype=np.float32) * np.float32(STEP)
    slopes = []
    for row in plus:
        policy.reset()
        above = policy.act(row)
        policy.reset()
        slopes.append((above.astype(float) - policy.act(-row)) / (2.0 * STEP))
    return np.array(slopes).T


def at_rest(plant: Any, policy: Policy) -> dict[str, Any] | None:
    """Closed-loop eigenvalues and margins at straight running; None where the policy or the task does not allow it.

    The observation's further entries are the last action: the loop's states are the car's and these.
    """
    names, model = list(plant.observation_names), plant.linear_model()
    memory = any(getattr(policy, "description", {}).get(name, 1) > 1 for name in ("hold", "history"))
    commands = [f"{axle}_steer_command" for axle in ("front", "rear") if plant.steer in (axle, "both")]
    if memory or model.state_names != STATE_NAMES or not set(names) <= {*STATE_NAMES, *commands}:
        return None
    slopes = jacobian(policy, len(names)) / plant.observation_scale
    axles = len(slopes)
    known = np.zeros((axles, len(STATE_NAMES)))
    last = np.zeros((axles, axles))
    for j, name in enumerate(names):
        if name in commands:
            last[:, commands.index(name)] = slopes[:, j] * model.input_scale[commands.index(name)]
        else:
            known[:, STATE_NAMES.index(name)] = slopes[:, j]
    zeros = np.zeros((axles, len(STATE_NAMES) + axles))
    A = np.vstack((np.hstack((model.A, np.zeros((len(model.A), axles)))), zeros))
    B = np.vstack((model.B, np.eye(axles)))
    loop = Loop(A, B, -np.hstack((known, last)), model.timestep, model.input_names)
    poles = eigenvalues(loop, 0)
    stable = bool(np.abs(poles[0]) < 1.0)
    return {
        "eigenvalues": [[float(pole.real), float(pole.imag)] for pole in poles],
        "stable": stable,
        "slowest_time_constant": -model.timestep / math.log(abs(poles[0])) if stable else None,
        "margins": {name: finite(one._asdict()) for name, one in margins(loop).items()} if stable else None,
        "delay": next((steps for steps in range(MOST_DELAY) if np.abs(eigenvalues(loop, steps + 1)[0]) >= 1.0), None)
        if stable
        else None,
    }


def eigenvalues(loop: Loop, delay: int) -> NDArray[np.complex128]:
    """Of the closed loop, the largest first, where all actions arrive so many control steps late."""
    states, axles = loop.B.shape
    A = np.zeros((states + delay * axles,) * 2)
    A[:states, :states] = loop.A
    acting = states + (delay - 1) * axles  # the oldest action under way
    if delay:
        A[:states, acting:] = loop.B
        A[states : states + axles, :states] = -loop.C
        A[states + axles :, states:acting] = np.eye(acting - states)
        # What the policy sees as its last action is the one given, not the one that arrives.
        own = slice(states - axles, states)
        A[own] = 0.0
        A[own, :states] = -loop.C
    else:
        A -= loop.B @ loop.C
    found: NDArray[np.complex128] = np.linalg.eigvals(A)
    return found[np.argsort(-np.abs(found))]


def finite(numbers: Mapping[str, float]) -> dict[str, float | None]:
    """None for what has no limit."""
    return {name: value if math.isfinite(value) else None for name, value in numbers.items()}


def asymmetry(plant: Any, policy: Policy) -> float:
    """The largest difference between an action and the mirror image of that to the mirror image, of full steer."""
    random = np.random.default_rng(0)
    seen = random.uniform(-0.3, 0.3, (64, len(plant.observation_names))).astype(np.float32)
    policy.reset()
    actions = policy.act(seen)
    policy.reset()
    mirrored = policy.act((seen * plant.observation_mirror).astype(np.float32))
    policy.reset()
    return float(np.max(np.abs(actions + mirrored)))


def limit(value: float | None, unit: str = "") -> str:
    """A number for people; None is none."""
    return "any" if value is None else f"{value:.3g}{unit}"


def sentences(name: str, row: Mapping[str, Any]) -> list[str]:
    """What people read about a policy."""
    said = []
    if row["asymmetry"] > ODD:
        said.append(f"{name}: not odd: mirror images are answered up to {row['asymmetry']:.3f} of full steer apart")
    rest = row["at_rest"]
    if rest is None:
        return said
    if not rest["stable"]:
        return [*said, f"{name}: UNSTABLE at straight running: |eigenvalue| {math.hypot(*rest['eigenvalues'][0]):.4f}"]
    bears = "; ".join(
        f"{axle.removesuffix('_command')}: gain {one['gain_decrease']:.2f} to {limit(one['gain_increase'])}, phase "
        f"{limit(None if one['phase'] is None else math.degrees(one['phase']), ' deg')}"
        for axle, one in rest["margins"].items()
    )
    late = limit(rest["delay"], " control steps late")
    slowest = f"slowest mode {rest['slowest_time_constant']:.2f} s"
    return [*said, f"{name}: stable at straight running, {slowest}, up to {late}; {bears}"]


def draw(found: Mapping[str, Any], environment: str, path: Path) -> None:
    """A panel for each quantity: success against it."""
    figure = new_figure(12.0, 6.2, f"{environment}: what the policies bear that were made for the nominal car and road")
    axes = figure.subplots(2, 4, sharey=True)
    for axis, (quantity, part) in zip(axes.flat, found.items(), strict=False):
        for k, (name, rows) in enumerate(part["policies"].items()):
            style = line_style(k)
            shares = np.array([row["success_rate"]["value"] for row in rows])
            low, high = np.array([row["success_rate"]["interval"] for row in rows]).T
            axis.plot(
                part["values"], 100.0 * shares, style.line, color=style.color, marker="o", markersize=3, label=name
            )
            axis.fill_between(part["values"], 100.0 * low, 100.0 * high, color=style.color, alpha=0.15)
        label = f"{quantity.replace('_', ' ')} [{UNITS.get(quantity, 'per the nominal one')}]"
        dress(axis, xlabel=label, ylim=(-3, 103))
        if axis.get_subplotspec().is_first_col():
            axis.set_ylabel("success [%]")
    for axis in list(axes.flat)[len(found) :]:
        axis.set_axis_off()
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    save(figure, path)


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.robustness", description=__doc__)
    messages.check_least(args, starts=1, seed=0)
    keywords = parse_keywords(args.env_keywords)
    if args.level is not None:
        if keywords.get("level", args.level) != args.level:
            raise UserError(f"--level {args.level}: --env-keywords says level {keywords['level']}")
        keywords |= {"level": args.level}
    env: Any = make_env(args.env_id, keywords)
    plant = env.unwrapped
    place = "-".join(filter(None, ("robustness", args.env_id, plant.scored_level)))
    out = args.json or Path("runs") / f"{place}.json"
    messages.check_output("--json", out)
    policies = named(args.policy, env)
    rows = {
        name: {"asymmetry": asymmetry(plant, one), "at_rest": at_rest(plant, one)} for name, one in policies.items()
    }
    with messages.progress() as bar:
        found = card(args.env_id, keywords, policies, start_seeds(args.starts, args.seed), bar)
    console = messages.console()
    for name, row in rows.items():
        for line in sentences(name, row):
            console.print(line)
    words = ["python", "-m", "agents.robustness", "--env-id", args.env_id]
    words += ["--level", args.level] if args.level else []
    words += ["--policy", *args.policy, *(["--env-keywords", args.env_keywords] if args.env_keywords != "{}" else [])]
    words += [word for name in ("starts", "seed") if getattr(args, name) != getattr(Args, name)
              for word in (f"--{name}", str(getattr(args, name)))]  # fmt: skip
    origin = {"command": shlex.join(words), **provenance.collect(), "env_id": args.env_id, "level": plant.scored_level}
    content = {**origin, "starts": args.starts, "seed": args.seed, "policies": rows, "changes": found}
    files.write_json(out, content)
    draw(found, " ".join(filter(None, (args.env_id, plant.scored_level))), out.with_suffix(".png"))
    console.print(f"written: {out}, {out.with_suffix('.png').name}")


if __name__ == "__main__":
    messages.run(main)
