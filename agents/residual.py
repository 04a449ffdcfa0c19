"""On top of a controller: the action that is learned is added to the controller's, which acts at every control step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents import scores, state_arrays
from agents.evaluate import make_vector_env
from agents.messages import UserError
from bicycle_env import control
from bicycle_env.control.network import BASE
from bicycle_env.control.policy import Policy
from bicycle_env.control.residual import added


def check(args: Any) -> None:
    """UserError for a trainer that would have the controller's action twice."""
    if args.residual and args.imitate:
        raise UserError(f"--residual: the policy must not begin as the image of {args.imitate}, too; give --imitate ''")


def base(name: str, plant: Any) -> control.TunablePolicy:
    """The controller, with the parameters tuned for the plant's id and level, or its own.

    Raises:
        UserError: there is none of that name for this plant, or no checkpoint can hold what it remembers.
    """
    env_id = plant.spec.id if plant.spec is not None else ""
    try:
        kind = control.tunable(name)
        if kind.__module__.partition(".")[0] != "bicycle_env":
            raise ValueError(f"{name!r} is not of this package, whose controllers a policy's file may name")
        law = control.make(name, plant, parameters=scores.tuned(env_id, plant.scored_level, name) or kind.usual(plant))
    except (TypeError, ValueError) as error:
        raise UserError(f"--residual: {error}") from None
    if type(law).reset is not Policy.reset and law.memory is None:
        raise UserError(f"--residual: no checkpoint can hold what {name} remembers")
    found: control.TunablePolicy = law  # type: ignore[assignment]
    return found


def manner(name: str, plant: Any) -> dict[str, Any]:
    """What a policy's file says of its base; nothing without a name."""
    if not name:
        return {}
    law = base(name, plant)
    names = [one.name for one in control.searched(type(law), plant)]
    return {BASE: {"controller": name, "parameters": dict(zip(names, law.values.tolist(), strict=True))}}


class OnTop:
    """A native vector environment, as with autoreset_mode="NextStep", whose actions are added to a controller's.

    Args:
        env_id, cars, keywords: of the environment.
        law: the controller, of this environment.
        hold: steps of the environment for which what is added stays the same.
    """

    def __init__(self, env_id: str, cars: int, keywords: Mapping[str, Any], law: Policy, hold: int) -> None:
        self._env: Any = make_vector_env(env_id, cars, dict(keywords), "Disabled").unwrapped
        self._law, self._hold = law, hold
        self.action_repeat: int = hold * self._env.action_repeat
        self._seen: Any = None
        self._over = np.zeros(cars, np.bool_)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def reset(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """As the environment's."""
        rows = None if options is None else options["reset_mask"]
        self._seen, info = self._env.reset(seed=seed, options=options)
        self._law.reset(rows)
        self._over = np.zeros_like(self._over) if rows is None else self._over & ~rows
        return self._seen, info

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """As the environment's with ``action_repeat``: the sum of the rewards; a row that has ended is reset."""
        rewards, over = np.zeros(len(self._over)), self._over
        for _ in range(self._hold):  # rows that have ended stay where they are, with reward 0
            self._seen, gained, terminated, truncated, info = self._env.step(added(self._law.act(self._seen), actions))
            rewards += gained
        if np.any(over):
            self.reset(options={"reset_mask": over})
            terminated, truncated = terminated & ~over, truncated & ~over
        self._over = terminated | truncated
        return self._seen, rewards, terminated, truncated, info

    def memory(self) -> state_arrays.State:
        """What the next step depends on, beside the cars."""
        memory = self._law.memory
        kept = {} if memory is None else {"base.memory": memory.of(len(self._over)).copy()}
        return {"base.over": self._over.copy(), **kept}

    def put(self, arrays: state_arrays.Arrays, seen: NDArray[np.float32]) -> None:
        """Put back what :meth:`memory` gave, where the cars are that see this."""
        self._seen, self._over = seen, arrays.take("base.over", np.bool_, len(self._over))
        if (memory := self._law.memory) is not None:
            memory.reset()
            numbers = memory.of(len(self._over))
            numbers[:] = arrays.take("base.memory", np.float64, *numbers.shape)


def state(env: Any) -> state_arrays.State:
    """That of the controller beneath, if there is one."""
    return env.memory() if isinstance(env, OnTop) else {}


def put(env: Any, arrays: state_arrays.Arrays, seen: NDArray[np.float32]) -> None:
    """Put back what :func:`state` gave."""
    if isinstance(env, OnTop):
        env.put(arrays, seen)
