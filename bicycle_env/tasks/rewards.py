"""Rewards: frozen objects, like tires. A task has two of its own, and a user may write another.

To write one, derive a frozen dataclass from :class:`Reward` and give it to an environment: ``reward=Mine(weight=2.0)``.
Its numbers are constants of the compiled code: other numbers are compiled anew.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.records import expression
from bicycle_env.physics.validation import check_fields, choice, explain_keywords, from_fields, positive
from bicycle_env.tasks.episode import EpisodeState, Reference, World

Law = Callable[..., Any]


class Reward(abc.ABC):
    """Base of the rewards: frozen, hashable, compared by value."""

    uses_horizon: ClassVar[bool] = False
    """Whether :meth:`forfeit` counts the steps up to ``rules.horizon``."""

    @abc.abstractmethod
    def law(self, xp: Any) -> Law:
        """``law(state, reference, action, episode, before, end, world) -> reward`` of a control step.

        ``state`` and ``reference`` are those after the step, ``episode`` is as it was before it (the last commands, the
        steps done), ``action`` is the pair (front, rear) in [-1, 1], ``before`` what :meth:`before` gave, ``end`` the
        end code. Written in the namespace xp, without ``if`` on data.
        """

    def before(self, xp: Any) -> Law | None:
        """``before(state, reference, action, world)``: a number from before the step; None where none is needed."""
        return None

    def forfeit(self, xp: Any, task: Any) -> Law | None:
        """``forfeit(steps, car, rules)``: what a failure after so many control steps adds to the reward; None: nothing.

        The task has the limits and the width of the corridor. Where many cars go on although an action was not finite,
        it is all that its step is paid.
        """
        return None


def plus_square(xp: Any) -> Law:
    """``plus_square(total, weight, value)``: total + weight x value^2, the one step of every sum here."""

    def plus_square(total: Any, weight: Any, value: Any) -> Any:
        return xp.multiply_add(weight, value * value, total)

    return plus_square


def squares(xp: Any, weights: tuple[float, ...]) -> Law:
    """``squares(total, values)``: total + the sum of weight x value^2, in the order of the weights."""
    sum_of = "total"
    for k, weight in enumerate(weights):
        sum_of = f"plus({sum_of}, {weight!r}, values[{k}])"
    return expression(xp, sum_of, "total, values", plus=plus_square(xp))  # type: ignore[no-any-return]


def _check_weights(reward: Any) -> None:
    check_fields(reward, **{field.name: (0.0,) for field in dataclasses.fields(reward) if field.init})


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Bounded(Reward):
    """1 / (1 + c) in (0, 1], c a weighted sum of squares: regulation of the new state, effort, smoothness.

    Effort is the squared action, smoothness the squared change of the action since the last step; both per axle.
    Weights are numbers >= 0, per m^2, rad^2 and (rad/s)^2.
    """

    name: str = dataclasses.field(default="bounded", init=False, repr=False, compare=False)
    lateral_weight: float = 0.0
    heading_weight: float = 0.0
    sideslip_weight: float = 0.0
    yaw_rate_weight: float = 0.0
    effort_weight: float = 0.0
    smoothness_weight: float = 0.0

    def __post_init__(self) -> None:
        _check_weights(self)

    def law(self, xp: Any) -> Law:
        regulation = (self.lateral_weight, self.heading_weight, self.sideslip_weight, self.yaw_rate_weight)
        plus = squares(xp, (*regulation, *(self.effort_weight,) * 2, *(self.smoothness_weight,) * 2))

        def bounded_reward(
            state: CarState,
            reference: Reference,
            action: Any,
            episode: EpisodeState,
            before: Any,
            end: Any,
            world: World,
        ) -> Any:
            car = world.car
            lateral = state.lateral_position - reference.lateral_position
            heading = state.heading - reference.heading
            # Reciprocals of what stays the same in an episode: the compiler moves them out of a loop over cars.
            per_speed, per_front, per_rear = 1.0 / car.speed, 1.0 / car.front_angle_limit, 1.0 / car.rear_angle_limit
            sideslip = state.lateral_velocity * per_speed
            front, rear = action
            front_change = xp.multiply_add(-episode.front_steer_command, per_front, front)
            rear_change = xp.multiply_add(-episode.rear_steer_command, per_rear, rear)
            errors = (lateral, heading, sideslip, state.yaw_rate)
            return 1.0 / plus(1.0, (*errors, front, rear, front_change, rear_change))

        return bounded_reward


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Quadratic(Reward):
    """-(x'Qx + u'Ru), diagonal Q and R, from the state before the step, its reference there, and the action.

    x is the lateral and the heading error, lateral velocity, yaw rate and both steers, u the actions. A failure also
    pays, for every step up to the horizon, the largest x'Qx + u'Ru of any state in which an episode is still running:
    to fail never pays. Costs are numbers >= 0, those of the commands > 0.
    """

    uses_horizon: ClassVar[bool] = True
    name: str = dataclasses.field(default="quadratic", init=False, repr=False, compare=False)
    lateral_cost: float = 0.0
    heading_cost: float = 0.0
    lateral_velocity_cost: float = 0.0
    yaw_rate_cost: float = 0.0
    front_steer_cost: float = 0.0
    rear_steer_cost: float = 0.0
    front_command_cost: float = 0.1
    rear_command_cost: float = 0.1

    def __post_init__(self) -> None:
        check_fields(self, positive, front_command_cost=(), rear_command_cost=())
        _check_weights(self)

    @property
    def state_costs(self) -> tuple[float, ...]:
        """Q's diagonal."""
        moving = (self.lateral_velocity_cost, self.yaw_rate_cost, self.front_steer_cost, self.rear_steer_cost)
        return (self.lateral_cost, self.heading_cost, *moving)

    @property
    def command_costs(self) -> tuple[float, float]:
        """R's diagonal, front and rear."""
        return self.front_command_cost, self.rear_command_cost

    def before(self, xp: Any) -> Law:
        plus = squares(xp, (*self.state_costs, *self.command_costs))

        def stage_reward(state: CarState, reference: Reference, action: Any, world: World) -> Any:
            lateral = state.lateral_position - reference.lateral_position
            heading = state.heading - reference.heading
            moving = (state.lateral_velocity, state.yaw_rate, state.front_steer, state.rear_steer)
            return -plus(0.0, (lateral, heading, *moving, action[0], action[1]))

        return stage_reward

    def law(self, xp: Any) -> Law:
        def quadratic_reward(
            state: CarState,
            reference: Reference,
            action: Any,
            episode: EpisodeState,
            before: Any,
            end: Any,
            world: World,
        ) -> Any:
            return before

        return quadratic_reward

    def forfeit(self, xp: Any, task: Any) -> Law:
        worst = xp.function(self.worst_stage_cost(xp, task))

        def forfeit(steps: Any, car: CarParameters, rules: Any) -> Any:
            return -(xp.maximum(rules.horizon - steps, 0.0) * worst(car))

        return forfeit

    def worst_stage_cost(self, xp: Any, task: Any) -> Law:
        """``worst(car)``: the largest x'Qx + u'Ru of any state in which an episode is still running.

        The lateral error is at most the width of the corridor plus half a body: the reference, too, lies within it.
        """
        plus, commands = squares(xp, self.state_costs), sum(self.command_costs)  # actions of 1
        limits, half_width = task.limits, float(task.road_half_width)
        sideslip, yaw_rate, heading = limits.sideslip, limits.yaw_rate, limits.heading

        def worst_stage_cost(car: CarParameters) -> Any:
            reach = xp.multiply_add(0.5, car.body_width, 2.0 * half_width)
            moving = (sideslip * car.speed, yaw_rate, car.front_angle_limit, car.rear_angle_limit)
            return plus(commands, (reach, 2.0 * heading, *moving))

        return worst_stage_cost


LAWS: dict[str, type[Reward]] = {"bounded": Bounded, "quadratic": Quadratic}
"""The laws that have a plain form."""


def resolve(reward: str | Reward | Mapping[str, Any], own: Mapping[str, Reward]) -> Reward:
    """A reward from a name among a task's own, from its plain form, or from itself.

    The plain form is what ``dataclasses.asdict`` makes: ``{"name": "bounded", "lateral_weight": 1.0, ...}``.

    Raises:
        ValueError: an unknown name or field, with the nearest known one; a bad value.
        TypeError: none of the three; a value of the wrong type.
    """
    if isinstance(reward, Reward):
        return reward
    if isinstance(reward, str):
        return own[choice("reward", reward, own)]
    if not isinstance(reward, Mapping):
        raise TypeError(f"reward must be one of {', '.join(map(repr, own))}, a Reward object or a dict, got {reward!r}")
    if "name" not in reward:
        raise ValueError(
            f"reward: a dict must have a 'name', one of {', '.join(map(repr, LAWS))}, got {dict(reward)!r}; a reward "
            "of one's own has no plain form: pass the object"
        )
    name = choice("reward: name", reward["name"], LAWS)
    return from_fields(f"reward {name!r}", LAWS[name], {key: reward[key] for key in reward if key != "name"})
