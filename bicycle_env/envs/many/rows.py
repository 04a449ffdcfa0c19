"""The numbers of all cars of a vector environment, set and read by name; and what may be asked of ``reset``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.envs.fleet import CAR_OPTIONS, Fleet, configure_fleet, is_sequence, number_column, with_options
from bicycle_env.envs.many.blocks import KEPT, Kind, layout, shared_numbers
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.validation import choice
from bicycle_env.tasks.episode import EpisodeState, Rules, World
from bicycle_env.tasks.task import Allowed, Task, allowed_number, checked_state

Column = NDArray[np.float64]


class VectorSnapshot(NamedTuple):
    """All that the future of a vector environment depends on."""

    rows: NDArray[Any]
    generators: tuple[Any, ...]
    names: tuple[str, ...] = ()
    """Of the numbers of the task's state."""


class Rows:
    """Blocks of rows in one flat array, and the array of what all rows share.

    Attributes: ``numbers``, flat: what all rows share, then the blocks; ``blocks``: how many.
    """

    def __init__(self, kind: Kind, fleet: Fleet, num_envs: int, step_limit: int | None) -> None:
        first, at, dtype = fleet.configuration, layout(kind), np.dtype(kind.dtype)
        self._num_envs, self._drawn = num_envs, kind.task.TaskState._fields
        self.blocks = -(-num_envs // kind.length)
        names = (*kind.model.State._fields, *KEPT, "end", *kind.task.TaskState._fields)
        self._names = {name: column for column, name in enumerate(names, start=at.state)}
        limits = (math.inf if step_limit is None else step_limit, first.steps_to_settle)
        world, entries = (
            World(first.car, first.rules, first.settings),
            (first.observation_scale, first.observation_bound),
        )
        shared = shared_numbers(kind, world, *entries, *limits)
        self.numbers = np.concatenate([shared, np.zeros(self.blocks * at.width * kind.length, dtype=dtype)])
        self._kept = at.scale if fleet.varied else at.car
        self._at = at
        self._shared, self._shape = len(shared), (self.blocks, at.width, kind.length)
        if fleet.varied:
            own = [*fleet.car, *fleet.settings, *(1.0 / fleet.observation_scale.T)]
            if len(own) != at.width - at.car:
                raise ValueError(f"a row must have {at.width - at.car} numbers of its own, got {len(own)}")
            for column, values in enumerate(own, start=at.car):
                self._columns[:, column] = np.ravel(values)[0]  # rows that fill up the last block, too
            self._put_all(at.car, own, np.ones(num_envs, dtype=np.bool_))

    @property
    def _columns(self) -> NDArray[Any]:
        """(blocks, columns, rows a block), a view of the numbers; made when asked for: a copy has its own."""
        return self.numbers[self._shared :].reshape(self._shape)

    @property
    def episodes(self) -> NDArray[Any]:
        """(blocks, columns, rows a block), a view: the episode, and what each car is made of, where they differ."""
        return self._columns[:, : self._kept]

    def put_cars(self, fleet: Fleet, mask: NDArray[np.bool_]) -> None:
        """What the cars in the rows of a mask are made of; the scales of what is observed stay."""
        self._put_all(self._at.car, [*fleet.car, *fleet.settings], mask)

    def cars(self, fleet: Fleet) -> tuple[CarParameters, Any]:
        """The cars' numbers and the task's, floats or (num_envs,), as they are driven: the fleet's if all are alike."""
        if not fleet.varied:
            return fleet.car, fleet.settings
        numbers = [self._of(column) for column in range(self._at.car, self._at.scale)]
        count = len(CarParameters._fields)
        return CarParameters(*numbers[:count]), type(fleet.settings)(*numbers[count:])

    def refill(self, task: Task, fleet: Fleet, rules: Rules, mask: NDArray[np.bool_]) -> None:
        """What the task keeps of a start, in the rows of a mask, after their starts were changed by options."""
        law = task.refilled(NUMPY)
        if law is not None:
            state, zero = self.record(fleet.configuration.model.State), np.zeros(self._num_envs)
            front, rear = (self.column(name) for name in KEPT[:2])
            episode = EpisodeState(front, rear, zero, zero, self.record(task.TaskState))
            car, settings = self.cars(fleet)
            self.put(law(state, episode, World(car, rules, settings))._asdict(), mask)

    def _put_all(self, first: int, values: list[Any], mask: NDArray[np.bool_]) -> None:
        for column, each in enumerate(values, start=first):
            self._put(column, np.broadcast_to(each, self._num_envs), mask)

    def _put(self, column: int, values: Any, mask: NDArray[np.bool_]) -> None:
        block, row = self._places(mask)
        self._columns[block, column, row] = values[mask]

    def _places(self, mask: NDArray[np.bool_]) -> Any:
        """Of the rows in a mask: the blocks, and where in them."""
        return np.divmod(np.flatnonzero(mask), self._shape[2])

    def column(self, name: str) -> Column:
        """(num_envs,): a copy of a number of the state or of the episode."""
        return self._of(self._names[name])

    def _of(self, column: int) -> Column:
        return self._columns[:, column].ravel()[: self._num_envs].astype(np.float64)

    def put(self, values: Mapping[str, Any], mask: NDArray[np.bool_]) -> None:
        """Set numbers by name, each one value or (num_envs,), in the rows of a mask."""
        for name, value in values.items():
            self._put(self._names[name], np.broadcast_to(value, self._num_envs), mask)

    def copy_of(self, mask: NDArray[np.bool_]) -> NDArray[Any]:
        """(rows, columns): all numbers of the rows in a mask."""
        block, row = self._places(mask)
        return self._columns[block, :, row]

    def put_back(self, copy: NDArray[Any], mask: NDArray[np.bool_]) -> None:
        """Restore what :meth:`copy_of` gave."""
        block, row = self._places(mask)
        self._columns[block, :, row] = copy

    def mixed(self, rows: NDArray[Any], others: NDArray[Any], names: Sequence[str]) -> NDArray[Any]:
        """Copies of ``episodes``: `rows`, with numbers of the task's state, by name, as in `others`."""
        columns = [self._names[choice("name", name, self._drawn)] for name in names]
        found = rows.copy()
        found[:, columns] = others[:, columns]
        return found

    def record(self, record: Any, **more: Column) -> Any:
        """A record of arrays (num_envs,): `more`, and numbers of the state and of the episode."""
        return record(**more, **{name: self.column(name) for name in record._fields if name not in more})


def checked_mask(mask: Any, num_envs: int) -> NDArray[np.bool_]:
    """(num_envs,): the rows to reset; all for None. ValueError or TypeError for another shape or type, or none."""
    if mask is None:
        return np.ones(num_envs, dtype=np.bool_)
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        raise TypeError(f"options['reset_mask'] must be a numpy array of bool, got {mask!r}")
    if mask.shape != (num_envs,) or not np.any(mask):
        raise ValueError(f"options['reset_mask'] must have shape ({num_envs},) and at least one True, got {mask!r}")
    return mask.copy()


def checked_cars(task: Task, options: Any, fleet: Fleet, num_envs: int) -> Fleet | None:
    """The fleet that the options ask for, or None. ValueError, TypeError before anything changes."""
    if not isinstance(options, Mapping):
        return None
    given = {name: options[name] for name in CAR_OPTIONS if name in options and name not in task.options}
    if given and not fleet.varied:
        raise ValueError(
            f"options: {', '.join(given)} must not be given here: the cars share their numbers; make the environment "
            "with varied=True, so that each has its own"
        )
    if not given:
        return None
    return configure_fleet(fleet.origin._replace(setup=with_options(fleet, given)), num_envs, True)


def checked_start(task: Task, options: Any, fleet: Fleet, num_envs: int, dtype: str) -> dict[str, Any]:
    """What the options set after a random start: values by name. ValueError, TypeError before anything changes."""
    given = task.check_options(options, ("reset_mask", *CAR_OPTIONS))
    changes: dict[str, Any] = {}
    if "state" in given:
        changes = _checked_states(given["state"], fleet, num_envs, dtype)
        placed = CarState(*(changes[name] for name in CarState._fields))
        changes = {**fleet.configuration.model.complete(NUMPY)(placed, fleet.car)._asdict(), **changes}
    unset = task.TaskState(*([math.nan] * len(task.TaskState._fields)))

    def read(name: str, value: Any, allowed: Allowed) -> Any:
        return allowed_column(name, value, allowed, num_envs)

    task_state = task.task_state_with(unset, task.option_numbers(given, read), fleet.car.speed)
    return changes | {name: value for name, value in task_state._asdict().items() if not np.any(np.isnan(value))}


def _checked_states(given: Any, fleet: Fleet, num_envs: int, dtype: str) -> dict[str, Any]:
    """The least and the greatest value of each name are checked, for all."""
    actuators = (fleet.configuration.front_actuator, fleet.configuration.rear_actuator)
    # A float32 state may be the limit rounded up.
    own = fleet.configuration.model.own
    front, rear = (max(one.angle_limit, float(np.dtype(dtype).type(one.angle_limit))) for one in actuators)
    if not isinstance(given, Mapping):
        return checked_state(given, front, rear, own=own)
    sequences = [name for name, value in given.items() if is_sequence(value)]
    columns = {name: number_column(f"options['state'][{name!r}]", given[name], num_envs) for name in sequences}
    for end in (np.min, np.max):
        ends = {name: end(column) for name, column in columns.items()}
        values = checked_state({**given, **ends}, front, rear, own=own)
    return {**values, **columns}


def allowed_column(name: str, value: Any, allowed: Allowed, num_envs: int) -> float | Column:
    """As ``allowed_number``, or (num_envs,) of them for so many words or numbers."""
    if not is_sequence(value):
        return allowed_number(name, value, allowed)
    if isinstance(allowed, Mapping):
        words = list(value)
        if len(words) != num_envs:
            raise ValueError(f"{name} must be one word or num_envs = {num_envs} of them, got {len(words)}")
        return np.array([allowed_number(f"{name}[{row}]", word, allowed) for row, word in enumerate(words)])
    column = number_column(name, value, num_envs)
    for end in (np.min(column), np.max(column)):
        allowed_number(name, end, allowed)
    return column
