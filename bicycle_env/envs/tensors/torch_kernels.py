"""Start, step and look of many cars on torch tensors: what ``kernels`` has compiled for one, from the same laws.

All is elementwise over the cars and nothing reads a value on the host, so a GPU never waits for it, and gradients
flow through it. torch is handed in: it is imported when an environment is made, not with this package.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any, NamedTuple

from bicycle_env.envs.fleet import Fleet
from bicycle_env.envs.telemetry import MOMENT
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import array_namespace
from bicycle_env.tasks.control_step import car_of_the_moment, parts
from bicycle_env.tasks.ends import INVALID_ACTION, RUNNING, clearance
from bicycle_env.tasks.episode import EpisodeState, World

Tensor = Any
INDUCTOR = {"realize_opcount_threshold": 4, "max_fusion_size": 100_000}
"""Options of torch.compile for long chains of elementwise operations. By default it copies an intermediate of up to 30
operations to each of its uses, and these chains grow: the Fiala tire's substep takes over ten minutes to compile. So
short ones are shared, and what shares them still becomes one loop: half a minute."""


class Episodes(NamedTuple):
    """All that changes while the cars drive: tensors (num_envs,)."""

    state: Any
    """The model's State."""
    episode: EpisodeState
    end: Tensor
    """int8, the codes of ``bicycle_env.tasks.ends``."""
    timed_out: Tensor
    """bool."""

    @property
    def over(self) -> Tensor:
        """bool (num_envs,): terminated or truncated."""
        return (self.end != RUNNING) | self.timed_out


class TorchKernels(NamedTuple):
    """Pure functions of tensors for one fleet and one task."""

    start: Callable[[Tensor], Episodes]
    """``start(uniforms)``: random starts from numbers in [0, 1), (task.uniforms, num_envs)."""
    step: Callable[[Episodes, Tensor], tuple[Episodes, Tensor]]
    """``step(episodes, action) -> (episodes, reward)``, action (num_envs, axles).

    A car whose action is not finite stays and ends; its reward is 0, the least there is; with the quadratic reward it
    pays for all steps that are left.
    """
    restart: Callable[[Tensor, Tensor, Episodes], Episodes]
    """``restart(rows, uniforms, episodes)``: random starts in the rows of a mask."""
    complete: Callable[[Mapping[str, Tensor]], Any]
    """The model's State of a CarState's values by name."""
    refill: Callable[[Episodes], Episodes]
    """What the task keeps of a start, after the starts were changed by options."""
    look: Callable[[Episodes], tuple[Tensor, Tensor]]
    """``look(episodes) -> (observation, cost)``: float32 (num_envs, entries), and (num_envs,)."""
    measure: Callable[[Episodes], dict[str, Tensor]]
    """Slip angles, forces, accelerations and the reference, by the names of the telemetry."""
    world: World
    """Its car and settings are tensors of one number, or of one per car."""


def mapped(function: Callable[..., Any], tree: Any, *others: Any) -> Any:
    """A function of each tensor in nested named tuples, and of the values at the same place in the others."""
    if isinstance(tree, tuple):
        parts = zip(tree, *others, strict=True)
        return type(tree)(*(mapped(function, *part) for part in parts))
    return function(tree, *others)


def chosen(condition: Tensor, then: Any, otherwise: Any) -> Any:
    """Row by row one of two nested named tuples."""
    return mapped(lambda a, b: a.where(condition, b), then, otherwise)


def torch_kernels(
    torch: Any, fleet: Fleet, num_envs: int, device: Any, dtype: Any, step_limit: float, compiled: bool
) -> TorchKernels:
    """Bind the laws to torch; `step_limit`: control steps until the time-out."""
    configuration = fleet.configuration
    task, model, rules = configuration.task, configuration.model, configuration.rules
    xp = array_namespace(torch, dtype)

    def tensor(value: Any) -> Tensor:
        return torch.tensor(value, dtype=dtype, device=device)

    car = CarParameters(*map(tensor, fleet.car))
    world = World(car, rules, type(fleet.settings)(*map(tensor, fleet.settings)))
    per_scale = tensor(1.0 / fleet.observation_scale)
    bound = torch.tensor(configuration.observation_bound, device=device)
    times = tensor(task.preview_times).unsqueeze(1)
    begin, advance, finish, accompany = parts(xp, task, model, configuration.reward)
    complete, start_law, reference_law, cost_law = model.complete(xp), task.start(xp), task.reference(xp), task.cost(xp)
    observe, preview = task.observe(xp), task.preview(xp)
    changing = task.conditions(xp) is not None
    moment = car_of_the_moment(xp, task)
    axles_law, forfeit_law = model.axles(xp, changing), configuration.reward.forfeit(xp, task)
    clearance_law, physics_timestep = clearance(xp, task), configuration.physics_timestep

    start_of_step = tensor(0.0) if changing else 0.0  # a tensor, so that the compiler takes no number for a constant

    def start(uniforms: Tensor) -> Episodes:
        state, task_state = start_law(uniforms.unbind(), world)
        state = complete(state, car)
        zero = 0.0 * state.heading
        episode = EpisodeState(zero, zero, zero, zero, mapped(lambda value: value.expand(num_envs), task_state))
        running = zero.to(torch.int8)
        return Episodes(state, episode, running, running != RUNNING)

    def completed(values: Mapping[str, Tensor]) -> Any:
        return complete(CarState(*(values[name] for name in CarState._fields)), car)

    def refill(episodes: Episodes) -> Episodes:
        law, episode = task.refilled(xp), episodes.episode
        if law is None:
            return episodes
        own = mapped(lambda value: value.expand(num_envs), law(episodes.state, episode, world))
        return episodes._replace(episode=episode._replace(task_state=own))

    def restart(rows: Tensor, uniforms: Tensor, episodes: Episodes) -> Episodes:
        restarted: Episodes = chosen(rows, start(uniforms), episodes)
        return restarted

    def prepare(before: Episodes, action: Tensor) -> tuple[Any, ...]:
        finite = torch.isfinite(action).all(dim=1)
        action = xp.minimum(xp.maximum(action.where(finite.unsqueeze(1), 0.0), -1.0), 1.0)
        steers = action.unbind(dim=1)
        pair = (steers[0] * rules.steers_front, steers[-1] * rules.steers_rear)
        return finite, pair, *begin(before.state, before.episode, pair, world)

    def substep(
        state: Any, episode: EpisodeState, command: tuple[Tensor, Tensor], elapsed: Any
    ) -> tuple[Any, EpisodeState]:
        moved = advance(state, episode, command, elapsed, world)
        if accompany is not None:
            episode = episode._replace(task_state=accompany(state, episode, elapsed, world))
        return moved, episode

    def conclude(
        before: Episodes,
        state: Any,
        along: EpisodeState,
        finite: Tensor,
        pair: tuple[Tensor, Tensor],
        command: tuple[Tensor, Tensor],
        number: Tensor,
    ) -> tuple[Episodes, Tensor]:
        episode, reward, end, _ = finish(state, along, pair, command, number, world)
        after = Episodes(state, episode, end.to(torch.int8), episode.steps >= step_limit)
        stopped = before._replace(end=INVALID_ACTION, timed_out=False)
        forfeit = 0.0 if forfeit_law is None else forfeit_law(before.episode.steps, car, rules)
        return chosen(finite, after, stopped), reward.where(finite, forfeit)

    def look(episodes: Episodes) -> tuple[Tensor, Tensor]:
        state, episode = episodes.state, episodes.episode
        values = torch.stack(observe(state, episode, world), dim=1)
        if len(times):
            ahead = preview(state, episode.task_state, world, times)  # (points, num_envs)
            values = torch.cat((values, ahead.T), dim=1)
        scaled = (values * per_scale).to(torch.float32)
        observation = xp.minimum(xp.maximum(scaled, -bound), bound)
        return observation, cost_law(state, reference_law(state, episode.task_state, world), episode, world)

    def measure(episodes: Episodes) -> dict[str, Tensor]:
        now = moment(episodes.state, episodes.episode, start_of_step, world)
        acting, zero = axles_law(episodes.state, now), 0.0 * episodes.state.heading
        reference = reference_law(episodes.state, episodes.episode.task_state, world)
        references = {f"reference_{name}": zero + value for name, value in reference._asdict().items()}
        clear = clearance_law(episodes.state, reference, episodes.episode, world)
        present = {name: zero + getattr(now, name) for name in MOMENT}
        return {**acting._asdict(), **references, **present, "clearance": clear}

    if compiled:  # one substep: the whole step, unrolled, would take the compiler minutes
        restart, prepare, substep, conclude, look = (
            _compiled(torch, law) for law in (restart, prepare, substep, conclude, look)
        )

    def step(before: Episodes, action: Tensor) -> tuple[Episodes, Tensor]:
        finite, pair, command, number = prepare(before, action)
        state, episode, elapsed = before.state, before.episode, start_of_step
        for _ in range(int(rules.substeps)):
            state, episode = substep(state, episode, command, elapsed)
            elapsed = elapsed + physics_timestep if changing else elapsed
        return conclude(before, state, episode, finite, pair, command, number)

    return TorchKernels(start, step, restart, completed, refill, look, measure, world)


def _compiled(torch: Any, law: Any) -> Any:
    # torch keeps a few compiled versions per code object and then refuses: each environment has a code object.
    own = FunctionType(law.__code__.replace(), law.__globals__, law.__name__, law.__defaults__, law.__closure__)
    return torch.compile(own, fullgraph=True, dynamic=False, options=INDUCTOR)
