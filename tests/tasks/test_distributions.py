"""What a parameter is drawn from: by its distribution function, in every backend, and as a keyword."""

import dataclasses

import gymnasium as gym
import numba
import numpy as np
import pytest
import scipy.stats
import torch
from combinations import only_all
from gymnasium.envs.registration import EnvSpec

from bicycle_env.backends.compiled import ENTRY_POINTS, NUMBA
from bicycle_env.backends.single_precision import NUMBA_FLOAT32
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.physics.elementary import NUMPY, PYTHON, array_namespace
from bicycle_env.physics.presets import vehicles
from bicycle_env.tasks import distributions, randomised
from bicycle_env.tasks.distributions import Choice, Distribution, LogUniform, Normal, Uniform
from bicycle_env.tasks.options import altered
from bicycle_env.tasks.stabilise import Stabilise

STAB = "BicycleStab-v0"
QUICK = {"tire": "linear", "geometry": "small_angle"}
UNIFORMS = np.linspace(0.0, 1.0, 4001)[:-1]
CASES = [
    (Uniform(0.3, 1.0), scipy.stats.uniform(0.3, 0.7).cdf),
    (LogUniform(0.2, 0.9), scipy.stats.loguniform(0.2, 0.9).cdf),
    (LogUniform(1e-4, 1e8), scipy.stats.loguniform(1e-4, 1e8).cdf),
    (Normal(1.0, 0.1, 0.9, 1.05), scipy.stats.truncnorm(-1.0, 0.5, 1.0, 0.1).cdf),
    (Normal(0.8, 0.1, 0.01, 10.0), scipy.stats.truncnorm(-4.0, 4.0, 0.8, 0.1).cdf),
    (Normal(0.5, 0.2, 0.5, 2.0), scipy.stats.truncnorm(0.0, 4.0, 0.5, 0.2).cdf),
    (Normal(0.6, 100.0, 0.4, 0.8), scipy.stats.uniform(0.4, 0.4).cdf),
]
DRAWN = {
    "friction": Normal(0.7, 0.1, 0.4, 1.0),
    "mass": Choice((0.9, 1.0, 1.2), relative=True),
    "yaw_inertia": LogUniform(0.8, 1.25, relative=True),
    "front_time_constant": Uniform(0.05, 0.1),
}


def values_of(distribution, xp=NUMPY, uniforms=UNIFORMS):
    return distribution.law(xp)(uniforms, own(distribution))


def own(distribution):
    numbers = distribution.numbers()
    return distributions.record_of("Numbers", tuple(numbers))(**numbers)


@pytest.mark.parametrize(("distribution", "share"), CASES, ids=range(len(CASES)))
def test_below_each_value_lies_its_share(distribution, share):
    values = values_of(distribution)
    low, high = distribution.bounds
    assert low <= values.min() < values.max() <= high
    assert (np.diff(values) >= 0.0).all()
    near = 2e-4 if isinstance(distribution, Normal) else 1e-12
    np.testing.assert_allclose(share(values), UNIFORMS, atol=near)


def test_what_lies_between_equal_ends_is_that():
    for distribution in (Uniform(0.5, 0.5), LogUniform(0.5, 0.5), Normal(0.5, 0.1, 0.5, 0.5), Choice([0.5])):
        assert np.all(values_of(distribution) == 0.5)


def test_each_value_of_a_choice_has_the_same_share():
    choice = Choice((3.0, 1.0, 2.0))
    assert choice.bounds == (1.0, 3.0)
    values, counts = np.unique(values_of(choice), return_counts=True)
    assert (values.tolist(), values_of(choice)[0]) == ([1.0, 2.0, 3.0], 3.0)
    assert np.ptp(counts) <= 1


@pytest.mark.parametrize("kind", [numba.float64, only_all(numba.float32)], ids=str)
def test_all_backends_give_the_same_numbers(kind):
    xp, near = (NUMBA, 1e-15) if kind is numba.float64 else (NUMBA_FLOAT32, 3e-6)
    dtype = np.dtype(str(kind))
    for distribution in DRAWN.values():
        expected = values_of(distribution)
        law, numbers = xp.function(distribution.law(xp)), type(own(distribution))(*map(dtype.type, own(distribution)))

        def run(uniforms, out, law=law, numbers=numbers):
            for k in range(len(out)):
                out[k] = law(uniforms[k], numbers)

        out = np.empty(len(UNIFORMS), dtype)
        numba.njit(run)(UNIFORMS.astype(dtype), out, law, numbers)
        if not isinstance(distribution, Choice) or kind is numba.float64:  # an edge is rounded
            np.testing.assert_allclose(out, expected, rtol=near)
        tensors = values_of(distribution, array_namespace(torch), torch.from_numpy(UNIFORMS))
        np.testing.assert_allclose(tensors.numpy(), expected, rtol=1e-14)
        python = distribution.law(PYTHON)
        assert [python(uniform, own(distribution)) for uniform in UNIFORMS.tolist()] == expected.tolist()


@pytest.mark.exhaustive
def test_one_car_many_and_tensors_draw_and_drive_alike():
    number, given = 8, {**QUICK, "randomise": DRAWN, "autoreset_mode": "Disabled"}
    many, tensors = gym.make_vec(STAB, number, **given).unwrapped, TorchVectorEnv(STAB, number, **given)
    alone = [gym.make(STAB, **QUICK, randomise=DRAWN).unwrapped for _ in range(number)]
    observation, info = many.reset(seed=3)
    for k, env in enumerate(alone):
        expected, told = env.reset(seed=3 + k)
        assert expected.tobytes() == observation[k].tobytes()
        assert {name: told[name] for name in DRAWN} == {name: info[name][k] for name in DRAWN}
    _, of_tensors = tensors.reset(seed=0)
    for name, distribution in DRAWN.items():
        nominal = getattr(vehicles["oversteer"], name) if distribution.relative else 1.0
        low, high = (end * nominal for end in distribution.bounds)
        for drawn in (info[name], of_tensors[name].numpy()):
            assert ((low <= drawn) & (drawn <= high)).all()
            assert len(set(drawn.tolist())) > 1
    tensors.set_state({name: torch.from_numpy(values) for name, values in many.state._asdict().items()})
    for action in np.random.default_rng(0).uniform(-1.0, 1.0, (20, number, 2)).astype(np.float32):
        observation, reward, *_ = many.step(action)
        for k, env in enumerate(alone):
            assert env.step(action[k])[0].tobytes() == observation[k].tobytes()
        np.testing.assert_allclose(tensors.step(torch.from_numpy(action))[1].numpy(), reward, rtol=1e-12, atol=1e-12)
    known = set(ENTRY_POINTS)
    gym.make(STAB, **QUICK, randomise={**DRAWN, "friction": Normal(0.6, 0.2, 0.3, 0.9)})
    assert set(ENTRY_POINTS) == known


# As keywords


def test_plain_forms_make_equal_tasks():
    plain = {name: dataclasses.asdict(distribution) for name, distribution in DRAWN.items()}
    assert altered(Stabilise(), randomise=plain) == altered(Stabilise(), randomise=DRAWN)
    assert plain["friction"]["name"] == "normal"
    pair, named = ({"mass": (0.9, 1.2, "relative")}, {"mass": {"low": 0.9, "high": 1.2, "relative": True}})
    assert randomised.resolve(pair) == randomised.resolve(named) == (("mass", Uniform(0.9, 1.2, relative=True)),)
    assert set(distributions.LAWS.values()) == {type(distribution) for distribution in DRAWN.values()}


def test_the_cars_at_the_corners_are_checked():
    drawn = randomised.resolve(
        {"mass": Choice((1.2, 0.9), relative=True), "front_time_constant": Normal(0.1, 0.1, 0.02, 1.0)}
    )
    mass = vehicles["oversteer"].mass
    assert sorted(car.mass for car in randomised.extremes(drawn, vehicles["oversteer"])) == [0.9 * mass, 1.2 * mass]
    with pytest.raises(ValueError, match="physics_timestep must be <="):
        gym.make(STAB, randomise={"mass": Choice((1.0, 1e-3), relative=True)})


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"name": "normall"}, ValueError, "name must be one of .*did you mean 'normal'"),
        ({"name": "normal", "mean": 0.5}, ValueError, "missing fields 'deviation', 'low', 'high'"),
        (
            {"name": "normal", "mean": 2.0, "deviation": 0.1, "low": 0.5, "high": 1.0},
            ValueError,
            r"mean must be .*\[0.5, 1\]",
        ),
        ({"name": "normal", "mean": 0.7, "deviation": 0.0, "low": 0.5, "high": 1.0}, ValueError, "deviation must be"),
        ({"name": "log_uniform", "low": 1.0, "high": 0.5}, ValueError, "high must be"),
        ({"name": "choice", "values": (0.5, -1.0)}, ValueError, r"values\[1\] must be .*got -1.0"),
        ({"name": "choice", "values": ()}, TypeError, "values must be a tuple of 1 to 32 numbers"),
        ({"name": "choice", "values": (1.0,) * 33}, TypeError, "values must be a tuple of 1 to 32 numbers"),
        (0.3, TypeError, r"must be \(low, high\) or .* or one of bicycle_env.distributions, got 0.3"),
        (Uniform, TypeError, "or one of bicycle_env.distributions, got <class"),
    ],
    ids=str,
)
def test_what_is_no_distribution_is_refused(given, error, words):
    with pytest.raises(error, match=rf"^randomise\['friction'\].*{words}"):
        altered(Stabilise(), randomise={"friction": given})


@dataclasses.dataclass(frozen=True)
class Squared(Distribution):
    """A user's own: most values are small."""

    relative: bool = False
    most: float = 1.0

    @property
    def bounds(self):
        return 0.2, 0.2 + self.most

    def numbers(self):
        return {"most": self.most}

    def law(self, xp):
        def squared(uniform, own):
            return xp.multiply_add(own.most, uniform * uniform, 0.2)

        return squared


def test_a_distribution_of_ones_own():
    task = altered(Stabilise(), randomise={"friction": Squared()})
    assert task.settings(30.0).friction_most == 1.0
    with pytest.raises(TypeError, match=r"randomise\['friction'\] Thawed must be a frozen dataclass"):
        altered(Stabilise(), randomise={"friction": type("Thawed", (Squared,), {"__dataclass_params__": None})()})


@pytest.mark.exhaustive
def test_json_makes_an_equal_environment_or_says_that_it_cannot():
    env = gym.make(STAB, **QUICK, randomise=DRAWN)
    assert gym.make(EnvSpec.from_json(env.spec.to_json())).unwrapped.task == env.unwrapped.task
    with pytest.raises(ValueError, match=r"randomise=.* is of one's own"):
        gym.make(STAB, **QUICK, randomise={"friction": Squared()}).spec.to_json()
