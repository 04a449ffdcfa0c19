"""The checks of arguments: each message names the parameter, the value and the allowed range."""

import dataclasses
import math

import numpy as np
import pytest

from bicycle_env.physics import validation


@pytest.mark.parametrize("good", [2, 2.0, np.float32(2.0), np.int64(2), np.array(2.0), np.array(2)])
def test_numbers_become_floats(good):
    value = validation.number("width", good)
    assert value == 2.0
    assert type(value) is float


@pytest.mark.parametrize(
    ("bounds", "bad", "allowed"),
    [
        ({}, math.nan, "a finite number"),
        ({"low": 0.0}, -1.0, "a finite number >= 0"),
        ({"high": 3.0}, 4.0, "a finite number <= 3"),
        ({"low": 0.0, "high": 3.0}, 4.0, r"a finite number in \[0, 3\]"),
        ({"low": 0.0, "high": 3.0}, -4.0, r"a finite number in \[0, 3\]"),
        ({"above": 0.0}, 0.0, "a finite number > 0"),
        ({"above": 0.0, "high": 2.0}, 2.5, "a finite number > 0 and <= 2"),
    ],
)
def test_a_number_out_of_range(bounds, bad, allowed):
    with pytest.raises(ValueError, match=rf"^width must be {allowed}, got {bad!r}$"):
        validation.number("width", bad, **bounds)


def test_the_edges_of_a_range_belong_to_it():
    assert validation.number("width", 0.0, 0.0, 3.0) == 0.0
    assert validation.number("width", 3.0, 0.0, 3.0) == 3.0


@pytest.mark.parametrize("bad", ["wide", None, True, np.True_, [1.0], np.array([1.0, 2.0]), 1j], ids=repr)
def test_what_is_no_number_is_shown(bad):
    with pytest.raises(TypeError) as caught:
        validation.number("width", bad)
    assert str(caught.value).startswith("width must be a finite number, got ")
    assert repr(bad) in str(caught.value)


def test_a_whole_number_too_large_for_a_float_is_named():
    with pytest.raises(ValueError, match="width"):
        validation.number("width", 10**400)


@pytest.mark.parametrize(("bad", "error"), [(0, ValueError), (-1, ValueError), (1.0, TypeError), (True, TypeError)])
def test_whole(bad, error):
    with pytest.raises(error, match=r"count must be a whole number in .1"):
        validation.whole("count", bad)
    assert type(validation.whole("count", np.int32(3))) is int


@pytest.mark.parametrize("quantity", validation.RANGES)
def test_a_range_holds_its_ends_and_nothing_beyond(quantity):
    for end, beyond in zip(validation.RANGES[quantity], (-math.inf, math.inf), strict=True):
        assert validation.in_range("given", end, quantity) == end
        for bad in (np.nextafter(end, beyond), beyond, math.nan):
            with pytest.raises(ValueError, match="given must be a finite number in"):
                validation.in_range("given", bad, quantity)


def test_in_range_or_infinite():
    assert validation.in_range_or_infinite("rate_limit", math.inf) == math.inf
    for bad in (-math.inf, math.nan, 0.0, 1e300):
        with pytest.raises(ValueError, match="rate_limit must be"):
            validation.in_range_or_infinite("rate_limit", bad)


def test_choice_proposes_the_nearest():
    assert validation.choice("colour", "red", ["red", "green"]) == "red"
    with pytest.raises(ValueError, match=r"colour must be one of 'red', 'green', got 'gren'; did you mean 'green'\?"):
        validation.choice("colour", "gren", ["red", "green"])
    with pytest.raises(TypeError, match="colour must be one of"):
        validation.choice("colour", 3, ["red"])


@pytest.mark.parametrize("bad", [1, 0, None, "yes", np.True_], ids=repr)
def test_flag(bad):
    with pytest.raises(TypeError, match="telemetry must be True or False"):
        validation.flag("telemetry", bad)


def test_known_keys():
    validation.known_keys("option", ["a"], ["a", "b"])
    with pytest.raises(ValueError, match=r"unknown option 'stat'; did you mean 'state'\? Allowed: 'state'"):
        validation.known_keys("option", {"stat": 1}, ["state"])
    with pytest.raises(KeyError, match="unknown option 3"):
        validation.known_keys("option", [3], ["state"], KeyError)


@pytest.mark.parametrize(
    ("value", "error", "match"),
    [
        (1.0, TypeError, r"span must be a pair \(low, high\), got 1.0"),
        ((1.0, 2.0, 3.0), TypeError, r"span must be a pair"),
        ((-1.0, 2.0), ValueError, r"span\[0\] must be a finite number in \[0, 5\]"),
        ((3.0, 2.0), ValueError, r"span\[1\] must be a finite number in \[3, 5\]"),
    ],
)
def test_a_pair_that_is_none_is_refused(value, error, match):
    with pytest.raises(error, match=match):
        validation.pair("span", value, 0.0, 5.0)


def test_fields_become_what_the_check_gives():
    @dataclasses.dataclass(frozen=True)
    class Spans:
        first: tuple[float, float] = (1, 2)
        second: float = 3
        third: int = 4

        def __post_init__(self):
            validation.check_fields(self, validation.pair, first=(0.0, 5.0))
            validation.check_fields(self, second=(0.0,))

    made = Spans(first=[0, 5])
    assert made == Spans((0.0, 5.0), 3.0, 4)
    assert [type(value) for value in (*made.first, made.second, made.third)] == [float, float, float, int]
    with pytest.raises(ValueError, match="second must be a finite number >= 0, got -1"):
        Spans(second=-1)
