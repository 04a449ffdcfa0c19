"""Start, step and look of cars on the tensors of torch or JAX: what numba has compiled for one, from the same laws.

All is elementwise over the cars and nothing reads a value on the host, so a GPU never waits for it, and gradients
flow through it. The library is handed in: it is imported when an environment is made, not with this package.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from bicycle_env.envs.fleet import Fleet
from bicycle_env.envs.telemetry import MOMENT
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import array_namespace
from bicycle_env.tasks.control_step import car_of_the_moment, parts
from bicycle_env.tasks.ends import INVALID_ACTION, RUNNING, clearance
from bicycle_env.tasks.episode import EpisodeState, World

Tensor = Any


class Library(NamedTuple):
    """A library of tensors, and what is not the same in all of them."""

    module: Any
    """torch, or jax.numpy: what they name alike is taken from here."""
    dtype: Any
    """Of the physics and of rewards."""
    tensor: Callable[[Any], Tensor]
    """Numbers in that type where the cars are."""
    cast: Callable[[Tensor, Any], Tensor]
    """``cast(tensor, type)``: gradients flow through it."""
    columns: Callable[[Tensor, int], Sequence[Tensor]]
    """``columns(tensor, axis)``: what stands along the axis, one by one."""
    shape: tuple[int, ...]
    """(num_envs,), or () for one car: JAX itself makes many of it."""
    repeated: Callable[[int, Callable[[Any], Any], Any], Any]
    """``repeated(count, body, carry)``: the body, so many times."""
    compiled: Callable[[Any], Any]
    """A law, compiled by itself where the library does that."""


class Episodes(NamedTuple):
    """All that changes while the cars drive: tensors of the library's shape."""

    state: Any
    """The model's State."""
    episode: EpisodeState
    end: Tensor
    """int8, the codes of ``bicycle_env.tasks.ends``."""
    timed_out: Tensor
    """bool."""

    @property
    def over(self) -> Tensor:
        """bool: terminated or truncated."""
        return (self.end != RUNNING) | self.timed_out


class TensorKernels(NamedTuple):
    """Pure functions of tensors for one fleet and one task."""

    start: Callable[[Tensor], Episodes]
    """``start(uniforms)``: random starts from numbers in [0, 1), the first axis of task.uniforms."""
    step: Callable[[Episodes, Tensor], tuple[Episodes, Tensor]]
    """``step(episodes, action) -> (episodes, reward)``, the axles on the action's last axis.

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
    """``look(episodes) -> (observation, cost)``: float32, the entries on the last axis, and
    one of each car."""
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


def chosen(where: Callable[[Tensor, Any, Any], Tensor], condition: Tensor, then: Any, otherwise: Any) -> Any:
    """Row by row one of two nested named tuples."""
    return mapped(lambda a, b: where(condition, a, b), then, otherwise)


def world_of(library: Library, fleet: Fleet) -> World:
    """The cars and the task's settings, as tensors of one number or of one per car."""
    car = CarParameters(*map(library.tensor, fleet.car))
    return World(car, fleet.configuration.rules, type(fleet.settings)(*map(library.tensor, fleet.settings)))


def tensor_kernels(library: Library, fleet: Fleet, world: World, step_limit: Any) -> TensorKernels:
    """Bind the laws to a library; `step_limit`: control steps until the time-out."""
    configuration, arrays, shape = fleet.configuration, library.module, library.shape
    task, model, rules = configuration.task, configuration.model, configuration.rules
    xp = array_namespace(arrays, library.dtype)
    car, tensor = world.car, library.tensor
    per_scale = tensor(1.0 / fleet.observation_scale)
    bound = library.cast(tensor(configuration.observation_bound), arrays.float32)
    times = tensor([[time] for time in task.preview_times] if shape else task.preview_times)  # the points first
    begin, advance, finish, accompany = parts(xp, task, model, configuration.reward)
    complete, start_law, reference_law, cost_law = model.complete(xp), task.start(xp), task.reference(xp), task.cost(xp)
    observe, preview = task.observe(xp), task.preview(xp)
    changing = task.conditions(xp) is not None
    moment = car_of_the_moment(xp, task)
    axles_law, forfeit_law = model.axles(xp, changing), configuration.reward.forfeit(xp, task)
    clearance_law, physics_timestep = clearance(xp, task), configuration.physics_timestep

    def spread(value: Tensor) -> Tensor:
        return arrays.broadcast_to(value, shape)

    def code(value: Tensor) -> Tensor:
        return library.cast(value, arrays.int8)

    start_of_step = tensor(0.0) if changing else 0.0  # a tensor, so that the compiler takes no number for a constant

    def start(uniforms: Tensor) -> Episodes:
        state, task_state = start_law(tuple(library.columns(uniforms, 0)), world)
        state = complete(state, car)
        zero = 0.0 * state.heading
        episode = EpisodeState(zero, zero, zero, zero, mapped(spread, task_state))
        running = code(zero)
        return Episodes(state, episode, running, running != RUNNING)

    def completed(values: Mapping[str, Tensor]) -> Any:
        return complete(CarState(*(values[name] for name in CarState._fields)), car)

    def refill(episodes: Episodes) -> Episodes:
        law, episode = task.refilled(xp), episodes.episode
        if law is None:
            return episodes
        own = mapped(spread, law(episodes.state, episode, world))
        return episodes._replace(episode=episode._replace(task_state=own))

    def restart(rows: Tensor, uniforms: Tensor, episodes: Episodes) -> Episodes:
        restarted: Episodes = chosen(arrays.where, rows, start(uniforms), episodes)
        return restarted

    def prepare(before: Episodes, action: Tensor) -> tuple[Any, ...]:
        finite = arrays.isfinite(action).all(-1)
        steers = [
            xp.minimum(xp.maximum(arrays.where(finite, steer, 0.0), -1.0), 1.0) for steer in library.columns(action, -1)
        ]
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
        after = Episodes(state, episode, code(end), episode.steps >= step_limit)
        stopped = before._replace(end=INVALID_ACTION, timed_out=False)
        forfeit = 0.0 if forfeit_law is None else forfeit_law(before.episode.steps, car, rules)
        return chosen(arrays.where, finite, after, stopped), arrays.where(finite, reward, forfeit)

    def look(episodes: Episodes) -> tuple[Tensor, Tensor]:
        state, episode = episodes.state, episodes.episode
        values = arrays.stack([spread(value) for value in observe(state, episode, world)], -1)
        if len(times):
            ahead = preview(state, episode.task_state, world, times)  # the points first
            values = arrays.concatenate((values, ahead.T), -1)
        scaled = library.cast(values * per_scale, arrays.float32)
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

    # One substep is compiled: the whole step, unrolled, would take the compiler minutes.
    restart, prepare, substep, conclude, look = map(library.compiled, (restart, prepare, substep, conclude, look))

    def step(before: Episodes, action: Tensor) -> tuple[Episodes, Tensor]:
        finite, pair, command, number = prepare(before, action)

        def body(carry: tuple[Any, EpisodeState, Any]) -> tuple[Any, EpisodeState, Any]:
            state, episode, elapsed = carry
            return *substep(state, episode, command, elapsed), elapsed + physics_timestep if changing else elapsed

        state, episode, _ = library.repeated(int(rules.substeps), body, (before.state, before.episode, start_of_step))
        return conclude(before, state, episode, finite, pair, command, number)

    return TensorKernels(start, step, restart, completed, refill, look, measure, world)
