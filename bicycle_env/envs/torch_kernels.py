"""Start, step and look of many cars on torch tensors: what ``kernels`` has compiled for one, from the same laws.

All is elementwise over the cars and nothing reads a value on the host, so a GPU never waits for it, and gradients
flow through it. torch is handed in: it is imported when an environment is made, not with this package.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from bicycle_env.envs.fleet import Fleet
from bicycle_env.physics.elementary import array_namespace
from bicycle_env.physics.single_track import Car, CarState, axles
from bicycle_env.tasks.ends import INVALID_ACTION, RUNNING, corner_outside
from bicycle_env.tasks.rewards import failure_cost
from bicycle_env.tasks.task import Memory, World
from bicycle_env.tasks.transition import stages

Tensor = Any
INDUCTOR = {"realize_opcount_threshold": 4, "max_fusion_size": 100_000}
"""Options of torch.compile for long chains of elementwise operations. By default it copies an intermediate of up to 30
operations to each of its uses, and these chains grow: the Fiala tire's substep takes over ten minutes to compile. So
short ones are shared, and what shares them still becomes one loop: half a minute."""


class Episodes(NamedTuple):
    """All that changes while the cars drive: tensors (num_envs,)."""

    state: CarState
    memory: Memory
    end: Tensor
    """int8, the codes of ``bicycle_env.tasks.ends``."""
    timed_out: Tensor
    """bool."""

    @property
    def over(self) -> Tensor:
        """bool (num_envs,): terminated or truncated."""
        return (self.end != RUNNING) | self.timed_out


def mapped(function: Callable[..., Any], tree: Any, *others: Any) -> Any:
    """A function of each tensor in nested named tuples, and of the values at the same place in the others."""
    if isinstance(tree, tuple):
        parts = zip(tree, *others, strict=True)
        return type(tree)(*(mapped(function, *part) for part in parts))
    return function(tree, *others)


def chosen(condition: Tensor, then: Any, otherwise: Any) -> Any:
    """Row by row one of two nested named tuples."""
    return mapped(lambda a, b: a.where(condition, b), then, otherwise)


class TorchKernels:
    """Pure functions of tensors for one fleet and one task; ``world`` holds what stays the same."""

    def __init__(
        self, torch: Any, fleet: Fleet, num_envs: int, device: Any, dtype: Any, step_limit: float, compiled: bool
    ) -> None:
        configuration = fleet.configuration
        task, tire, geometry = configuration.task, configuration.tire, configuration.geometry
        xp = array_namespace(torch)
        self._torch, self._xp = torch, xp
        self._num_envs = num_envs
        self._step_limit = step_limit
        self._steps_to_settle = configuration.steps_to_settle
        self._pays_for_failure = configuration.reward == "quadratic"

        def tensor(value: Any) -> Tensor:
            return torch.tensor(value, dtype=dtype, device=device)

        self.world = World(
            Car(*map(tensor, fleet.car)), configuration.rules, type(fleet.settings)(*map(tensor, fleet.settings))
        )
        self._scale = tensor(fleet.observation_scale)
        self._bound = torch.tensor(configuration.observation_bound, device=device)
        self._times = tensor(task.preview_times).unsqueeze(1)
        self._start = task.start(xp)
        self._begin, self._advance, self._finish = stages(xp, task, tire, geometry, configuration.reward)
        if compiled:  # one substep: the whole step, unrolled, would take the compiler minutes
            self._advance = torch.compile(self._advance, fullgraph=True, dynamic=False, options=INDUCTOR)
        self._observe, self._preview = task.observe(xp), task.preview(xp)
        self._reference, self._cost = task.reference(xp), corner_outside(xp)
        self._failure_cost = failure_cost(xp)
        self._axles = axles(xp, tire, geometry)

    def start(self, uniforms: Tensor) -> Episodes:
        """Random starts from numbers in [0, 1): (task.uniforms, num_envs)."""
        state, route = self._start(uniforms.unbind(), self.world)
        zero = 0.0 * state.heading
        memory = Memory(zero, zero, zero, zero, mapped(lambda value: value.expand(self._num_envs), route))
        running = zero.to(self._torch.int8)
        return Episodes(state, memory, running, running != RUNNING)

    def step(self, before: Episodes, action: Tensor) -> tuple[Episodes, Tensor]:
        """``(episodes, reward)`` one control step later; a car whose action is not finite stays and ends.

        It gets the reward 0, the least there is; with the quadratic reward it pays for all steps that are left.
        """
        finite = self._torch.isfinite(action).all(dim=1)
        action = self._xp.minimum(self._xp.maximum(action.where(finite.unsqueeze(1), 0.0), -1.0), 1.0)
        rules = self.world.rules
        steers = action.unbind(dim=1)
        pair = (steers[0] * rules.steers_front, steers[-1] * rules.steers_rear)
        command, stage = self._begin(before.state, before.memory, pair, self.world)
        state = before.state
        for _ in range(int(rules.substeps)):
            state = self._advance(state, command, self.world)
        memory, reward, end, _ = self._finish(state, before.memory, pair, stage, self.world)
        after = Episodes(state, memory, end.to(self._torch.int8), memory.steps >= self._step_limit)
        stopped = before._replace(end=INVALID_ACTION, timed_out=False)
        forfeit = -self._failure_cost(before.memory.steps, self.world.car, rules) if self._pays_for_failure else 0.0
        return chosen(finite, after, stopped), reward.where(finite, forfeit)

    def look(self, episodes: Episodes) -> tuple[Tensor, Tensor]:
        """``(observation, cost)``: float32 (num_envs, entries), and (num_envs,)."""
        state, memory = episodes.state, episodes.memory
        values = self._torch.stack(self._observe(state, memory, self.world), dim=1)
        if len(self._times):
            ahead = self._preview(state, memory.route, self.world, self._times)  # (points, num_envs)
            values = self._torch.cat((values, ahead.T), dim=1)
        scaled = (values / self._scale).to(self._torch.float32)
        observation = self._xp.minimum(self._xp.maximum(scaled, -self._bound), self._bound)
        cost = self._cost(state, self._reference(state, memory.route, self.world), self.world)
        return observation, cost

    def success(self, episodes: Episodes) -> Tensor:
        """bool (num_envs,): running, and settled for the last second."""
        return (episodes.memory.settled_steps >= self._steps_to_settle) & (episodes.end == RUNNING)

    def measure(self, episodes: Episodes) -> dict[str, Tensor]:
        """Slip angles, forces, accelerations and the reference, by the names of the telemetry."""
        acting = self._axles(episodes.state, self.world.car)
        reference = self._reference(episodes.state, episodes.memory.route, self.world)
        return {**acting._asdict(), **{f"reference_{name}": value for name, value in reference._asdict().items()}}
