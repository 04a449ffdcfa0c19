"""A yaw rate to follow, and the reward of following it without sideslip and of running straight afterwards."""

from __future__ import annotations

import dataclasses
from typing import Any

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.validation import check_fields, explain_keywords
from bicycle_env.physics.vehicle import GRAVITY
from bicycle_env.tasks import rewards
from bicycle_env.tasks.episode import EpisodeState, Reference, World
from bicycle_env.tasks.fmvss126 import judgement, since_finish
from bicycle_env.tasks.randomised import nominal_friction
from bicycle_env.tasks.task import Law

GRIP_SHARE = 0.85
"""Of the friction that the reference yaw rate may take."""
UNDERSTEER = 0.0015
"""s^2/m^2, of the car whose yaw rate is the reference: characteristic speed 26 m/s."""
SETTLING = 0.5
"""s after the driver in which the reward comes to ask for straight running."""


def reference_yaw_rate(xp: Any) -> Law:
    """``reference_yaw_rate(own, car) -> rad/s``: of an understeering car, within what the true friction allows."""

    def reference_yaw_rate(own: Any, car: CarParameters) -> Any:
        speed, length = own.speed, car.cg_to_front + car.cg_to_rear
        wanted = (speed / length) * own.twin_front_steer / xp.multiply_add(UNDERSTEER, speed * speed, 1.0)
        most = (GRIP_SHARE * GRAVITY) * own.relative_friction * nominal(car) / speed
        return xp.maximum(xp.minimum(wanted, most), -most)

    nominal = xp.function(nominal_friction)
    return reference_yaw_rate


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Steadiness(rewards.Reward):
    """scale / (1 + c) per step, c from the yaw rate's error, sideslip and the action's change; less for what fails.

    c = yaw_rate_weight (r - r_ref)^2 + sideslip_weight max(0, |beta| - free_sideslip)^2 + smoothness_weight |du|^2
    + after settling_weight (r^2 + beta^2), `after` rising from 0 to 1 in the half second after the driver. A spin, a
    yaw rate that was too large and a displacement that was too small cost `failure` each, once.
    """

    name: str = dataclasses.field(default="steadiness", init=False, repr=False, compare=False)
    scale: float = 0.1
    yaw_rate_weight: float = 30.0
    sideslip_weight: float = 60.0
    free_sideslip: float = 0.05
    smoothness_weight: float = 0.05
    settling_weight: float = 100.0
    failure: float = 30.0
    """What a whole episode pays at most: with less, a search on the return gives successes away (agents.alignment)."""

    def __post_init__(self) -> None:
        check_fields(self, **{field.name: (0.0,) for field in dataclasses.fields(self)[1:]})

    def law(self, xp: Any) -> Law:
        plus, judge = xp.function(rewards.plus_square(xp)), xp.function(judgement(xp))
        wanted, since = xp.function(reference_yaw_rate(xp)), xp.function(since_finish)
        scale, failure, free_sideslip = self.scale, self.failure, self.free_sideslip
        yaw_rate_weight, sideslip_weight = self.yaw_rate_weight, self.sideslip_weight
        smoothness_weight, settling_weight = self.smoothness_weight, self.settling_weight

        def steadiness(
            state: CarState,
            reference: Reference,
            action: Any,
            episode: EpisodeState,
            before: Any,
            end: Any,
            world: World,
        ) -> Any:
            own, car = episode.task_state, world.car
            sideslip = state.lateral_velocity / own.speed
            late = since(own, (episode.steps + 1.0) * world.rules.control_timestep)
            after = settling_weight * xp.minimum(xp.maximum(late / SETTLING, 0.0), 1.0)
            total = plus(1.0, yaw_rate_weight, state.yaw_rate - wanted(own, car))
            total = plus(total, sideslip_weight, xp.maximum(abs(sideslip) - free_sideslip, 0.0))
            total = plus(total, smoothness_weight, action[0] - own.front_correction / car.front_angle_limit)
            total = plus(total, smoothness_weight, action[1] - episode.rear_steer_command / car.rear_angle_limit)
            total = plus(plus(total, after, state.yaw_rate), after, sideslip)
            _, fast, short = judge(state, episode, world)
            zero = 0.0 * total
            lost = xp.where(fast & (own.yaw_rate_missed < 0.5), failure + zero, 0.0)
            lost = lost + xp.where(short, failure + zero, 0.0)
            lost = lost + xp.where(end > 0, failure + zero, 0.0)
            return scale / total - lost

        return steadiness
