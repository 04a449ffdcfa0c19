"""A preset's name stands for its Vehicle in every function of ``bicycle_env.analysis``."""

import inspect

import numpy as np
import pytest

from bicycle_env import analysis, vehicles

ARGUMENTS = {
    "speed": 30.0,
    "input": "rear_steer",
    "output": "lateral_acceleration",
    "lateral_rate": 0.3,
    "heading": -0.02,
    "yaw_rate": 0.1,
    "lateral_acceleration": 2.0,
}
FUNCTIONS = [getattr(analysis, name) for name in analysis.__all__ if inspect.isroutine(getattr(analysis, name))]
LINEAR = [
    function
    for function in FUNCTIONS
    if function.__module__.rpartition(".")[2] in ("stability", "inertial", "transfer_functions")
]


UNNEEDED = ("lane", "geometry", "progress", "radius", "relaxation_length")
"""What has no value but can do without."""


def arguments(function):
    """What the function cannot do without, or has no value for, except for the vehicle, which comes first."""
    first, *others = inspect.signature(function).parameters.values()
    assert first.name == "vehicle"
    open_ones = [each.name for each in others if each.default is each.empty or each.default is None]
    return {name: ARGUMENTS[name] for name in open_ones if name not in UNNEEDED}


def numbers(value):
    """The answer as one array; of a transfer function or a state space, its response at 1 rad/s."""
    if callable(value):
        value = value(1j)
    if isinstance(value, tuple):
        return np.hstack([numbers(part) for part in value])
    return np.ravel(value)


def test_the_linear_functions_are_found():
    assert len(LINEAR) >= 20


@pytest.mark.parametrize("function", LINEAR, ids=lambda function: function.__name__)
def test_the_name_and_the_vehicle_give_the_same(function):
    by_name = numbers(function("oversteer", **arguments(function)))
    np.testing.assert_array_equal(by_name, numbers(function(vehicles["oversteer"], **arguments(function))))


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.__name__)
def test_anything_else_is_refused_by_name(function):
    with pytest.raises(ValueError, match=r"vehicle must be one of .*got 'oversteeer'; did you mean 'oversteer'\?"):
        function("oversteeer", **arguments(function))
    with pytest.raises(TypeError, match=r"vehicle must be one of .*got 1500\.0"):
        function(1500.0, **arguments(function))
