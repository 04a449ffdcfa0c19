"""Public attributes that say what an environment is: they can be read, and a change of them would do nothing."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Value = TypeVar("Value")


class Told(Generic[Value]):
    """An attribute that an environment tells once, with :meth:`tell`, and that nobody can set afterwards.

    The value lies in the instance's dictionary under its own name, so copies and pickles have it, too.

    Raises:
        AttributeError: where it is set or deleted; the message names what does change an environment.
    """

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, env: object | None, owner: type) -> Value:
        if env is None:
            return self  # type: ignore[return-value]
        try:
            value: Value = env.__dict__[self._name]
        except KeyError:
            raise AttributeError(f"{owner.__name__} has no {self._name} yet") from None
        return value

    def __set__(self, env: object, value: Any) -> None:
        raise AttributeError(read_only(self._name))

    def __delete__(self, env: object) -> None:
        raise AttributeError(read_only(self._name))


def tell(env: object, **values: Any) -> None:
    """Write told attributes, in the constructor or where the environment itself changes them."""
    env.__dict__.update(values)


def read_only(name: str) -> str:
    """What an attempt to set a public attribute is answered."""
    return (
        f"{name} cannot be set: it would change nothing. Give it as a keyword to gym.make, gym.make_vec or "
        "TorchVectorEnv; states are set by reset(options={'state': ...})"
    )


def frozen(values: Any) -> Any:
    """An array that refuses to be written to; what is no array stays as it is."""
    if not isinstance(values, np.ndarray):
        return values
    copy: NDArray[Any] = values.copy()
    copy.flags.writeable = False
    return copy
