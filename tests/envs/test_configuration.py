"""What a configuration refuses, so that everything it accepts can be driven with finite numbers."""

import math

import numpy as np
import pytest
from combinations import only_all

from bicycle_env import Actuator, Vehicle, tires
from bicycle_env.envs.configuration import configure
from bicycle_env.envs.setup import Setup
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.validation import RANGES
from bicycle_env.physics.vehicle import QUANTITIES
from bicycle_env.tasks.control_step import transition
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.stabilise import Stabilise

LENGTHS = ("front_half_track", "rear_half_track", "front_overhang", "rear_overhang", "body_width")
DEFAULTS = {"horizon": None, "speed_ratio": None}


def drawn(rng, quantity):
    """Log-uniform in its range; each end comes up now and then."""
    low, high = RANGES[quantity]
    place = rng.choice([0.0, 1.0, rng.random()], p=[0.1, 0.1, 0.8])
    return float(np.clip(low * (high / low) ** place, low, high))


def any_configuration(rng):
    """Keywords anywhere in the documented ranges; the physics timestep fits the car, if one can."""
    vehicle = Vehicle(
        **{name: drawn(rng, quantity) for name, quantity in QUANTITIES.items()},
        **{name: drawn(rng, "length") for name in ("cg_to_front", "cg_to_rear", *LENGTHS)},
    )
    actuators = [
        Actuator(
            drawn(rng, "angle_limit"),
            math.inf if rng.random() < 0.3 else drawn(rng, "rate_limit"),
            10.0 ** rng.uniform(-3, 2),
        )
        for _ in range(2)
    ]
    tire = rng.choice(
        [tires.Linear(), tires.Tanh(), tires.Fiala(), tires.MagicFormula(rng.uniform(0.1, 1.99), -1000.0)]
    )
    timestep = 10.0 ** rng.uniform(-6, 1)
    return {
        **DEFAULTS,
        "vehicle": vehicle,
        "tire": tire,
        "speed": drawn(rng, "speed"),
        "friction": drawn(rng, "friction"),
        "steer": "both",
        "geometry": str(rng.choice(["small_angle", "exact"])),
        "reward": str(rng.choice(["default", "quadratic"])),
        "front_actuator": actuators[0],
        "rear_actuator": actuators[1],
        "physics_timestep": timestep,
        "control_timestep": min(4.0 * timestep, 10.0) if timestep <= 2.5 else timestep,
    }


def drive(configuration, rng, steps):
    """Every number of an episode in plain Python: states, observations, rewards, costs."""
    task, world = configuration.task, World(configuration.car, configuration.rules, configuration.settings)
    step = transition(PYTHON, task, configuration.model, configuration.reward)
    observe = task.observe(PYTHON)
    state, route = task.start(PYTHON)([float(u) for u in rng.random(task.uniforms)], world)
    memory = EpisodeState(0.0, 0.0, 0.0, 0.0, route)
    for _ in range(steps):
        action = tuple(float(a) for a in rng.choice([-1.0, 1.0, 0.3], 2))
        state, memory, reward, end, cost = step(state, memory, action, world, configuration.substeps)
        yield [
            *state,
            *memory[:4],
            reward,
            cost,
            *(np.array(observe(state, memory, world)) / configuration.observation_scale),
        ]
        if end:
            return


@pytest.mark.filterwarnings("ignore::bicycle_env.physics.vehicle.UnitWarning")
@pytest.mark.parametrize(("configurations", "most_steps"), [(250, 15), only_all(500, 50)])
def test_whatever_is_within_the_ranges_drives_with_finite_numbers(configurations, most_steps):
    rng, accepted, steps = np.random.default_rng(0), 0, 0
    for _ in range(configurations):
        keywords = any_configuration(rng)
        try:
            configuration = configure(Stabilise(), Setup(**keywords))
        except ValueError as error:
            assert "timestep must be" in str(error)  # noqa: PT017
            continue
        accepted += 1
        for numbers in drive(configuration, rng, most_steps):
            steps += 1
            assert np.all(np.isfinite(numbers)), (keywords, numbers)
    assert accepted >= 40
    assert steps >= 200


USUAL = {
    **DEFAULTS,
    "vehicle": "oversteer",
    "tire": "linear",
    "speed": 43.0,
    "friction": 1.0,
    "steer": "both",
    "geometry": None,
    "reward": "default",
    "front_actuator": Actuator(0.1),
    "rear_actuator": Actuator(0.1),
    "physics_timestep": 0.005,
    "control_timestep": 0.02,
}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("friction", 1e308),
        ("friction", 5e-324),
        ("friction", 11.0),
        ("control_timestep", 10.1),
        ("physics_timestep", 1e-7),
    ],
)
def test_legal_looking_extremes_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} must be a finite number in"):
        configure(Stabilise(), Setup(**{**USUAL, name: value}))


def test_a_car_that_grows_out_of_all_numbers_within_one_step_is_refused():
    """With a linear tire and small angles nothing holds it: after 10 s it is at e^600."""
    wild = Vehicle(
        mass=1500.0,
        yaw_inertia=25.0,
        cg_to_front=3.0,
        cg_to_rear=0.1,
        front_cornering_stiffness=1e5,
        rear_cornering_stiffness=1e5,
    )
    with pytest.raises(ValueError, match=r"control_timestep must be <= .* s here, got 10: without steering, a dev"):
        configure(Stabilise(), Setup(**{**USUAL, "vehicle": wild, "physics_timestep": 0.001, "control_timestep": 10.0}))
