"""One source of physics: the same laws in plain Python, numba, numpy and torch give the same trajectories."""

import dataclasses
import itertools

import gymnasium as gym
import numba
import numpy as np
import pytest
import torch
from combinations import only_all
from numba.np.unsafe.ndarray import to_fixed_tuple

import bicycle_env
from bicycle_env import analysis, simulate, tires, vehicles
from bicycle_env.backends import compiled
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarParameters, CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY, PYTHON, array_namespace
from bicycle_env.physics.integrators import rk4
from bicycle_env.physics.lateral import GEOMETRIES
from bicycle_env.physics.single_track import SingleTrack

TORCH = array_namespace(torch)
FIELDS, NUMBERS = len(CarState._fields), len(CarParameters._fields)
STEPS, SUBSTEPS, TIMESTEP = 200, 5, 0.004
PIECE = 20
OVERSTEER = vehicles["oversteer"]
CAR = car_on_road(OVERSTEER, 1.2 * OVERSTEER.critical_speed, 1.0, FRONT, REAR)


def starts(count=3):
    """(cars, fields): small random states."""
    widths = CarState(1.0, 0.2, 0.02, 0.5, 0.05, 0.01, 0.01)
    return np.random.default_rng(5).uniform(-1.0, 1.0, (count, FIELDS)) * np.array(widths)


def commands(steps=STEPS):
    """(steps, 2): sweeps of both axles to their limits, slow and fast, that reach the rate limits too."""
    time = np.arange(steps) * SUBSTEPS * TIMESTEP
    front = CAR.front_angle_limit * np.sin(7.0 * time + 0.4 * time**2)
    rear = CAR.rear_angle_limit * np.sign(np.sin(4.0 * time + 1.0)) * 0.8
    return np.column_stack([front, rear])


def law_of(xp, tire, geometry):
    return rk4(xp, CarState, SingleTrack(tire, geometry).actuated_rates(xp))


def in_python(tire, geometry, start):
    advance = law_of(PYTHON, tire, geometry)
    state, path = CarState(*start.tolist()), [start]
    for command in map(tuple, commands().tolist()):
        for _ in range(SUBSTEPS):
            state = advance(state, command, command, command, CAR, TIMESTEP)
        path.append(state)
    return np.array(path, dtype=float)


def in_numba(tire, geometry, start):
    advance = compiled.inlined(law_of(compiled.NUMBA, tire, geometry))

    def drive(start, numbers, commands, path):
        car, state = CarParameters(*to_fixed_tuple(numbers, NUMBERS)), CarState(*to_fixed_tuple(start, FIELDS))
        for k in range(len(path)):
            for j in range(FIELDS):
                path[k, j] = state[j]
            if k < len(commands):
                command = (commands[k, 0], commands[k, 1])
                for _ in range(SUBSTEPS):
                    state = advance(state, command, command, command, car, TIMESTEP)

    row, table = numba.float64[::1], numba.float64[:, ::1]
    path = np.empty((STEPS + 1, FIELDS))
    compiled.entry_point(drive, numba.void(row, row, table, table))(start, np.array(CAR), commands(), path)
    return path


def in_arrays(xp, convert, tire, geometry, start, orders):
    """All cars at once, by orders (steps, 2, cars); `convert` makes the backend's array of a numpy array."""
    advance = law_of(xp, tire, geometry)
    state, path = CarState(*(convert(column.copy()) for column in start.T)), []
    car = CarParameters(*(convert(np.full(len(start), value)) for value in CAR))
    path.append(np.array([np.asarray(values) for values in state]))
    for order in orders:
        both = tuple(convert(angles.copy()) for angles in order)
        for _ in range(SUBSTEPS):
            state = advance(state, both, both, both, car, TIMESTEP)
        path.append(np.array([np.asarray(values) for values in state]))
    assert all(values.dtype == state.heading.dtype for values in state)
    return np.array(path).transpose(2, 0, 1)


def in_pieces(xp, convert, tire, geometry, reference):
    """The reference's paths (cars, STEPS + 1, fields), PIECE steps from each PIECE-th state: all pieces at once."""
    cars, pieces = len(reference), STEPS // PIECE
    start = reference[:, :-1:PIECE].reshape(-1, FIELDS)
    orders = np.tile(commands().reshape(pieces, PIECE, 2).transpose(1, 2, 0), cars)
    paths = in_arrays(xp, convert, tire, geometry, start, orders)
    assert paths.dtype == np.float64
    return np.concatenate([reference[:, :1], paths[:, 1:].reshape(cars, STEPS, FIELDS)], axis=1)


def in_numpy(tire, geometry, reference):
    return in_pieces(NUMPY, np.asarray, tire, geometry, reference)


@torch.inference_mode()
def in_torch(tire, geometry, reference):
    return in_pieces(TORCH, torch.from_numpy, tire, geometry, reference)


def distance(path, reference):
    return np.max(np.abs(path - reference) / np.maximum(1.0, np.abs(reference)))


def test_the_commands_excite_the_car():
    path = in_python(tires.Fiala(), "exact", starts()[0])
    steer_rate = np.abs(np.diff(path[:, 5])) / (SUBSTEPS * TIMESTEP)
    assert steer_rate.max() == pytest.approx(FRONT.rate_limit, rel=1e-6)
    assert np.abs(path[:, 3]).max() > 0.1 * CAR.speed  # far into sliding
    slip = np.arctan2(path[:, 3] + OVERSTEER.cg_to_front * path[:, 4], CAR.speed) - path[:, 5]
    assert np.abs(slip).max() > np.arctan(3.0 * CAR.front_peak_force / CAR.front_cornering_stiffness)


DEFAULTS = [("fiala", "exact")]


@pytest.mark.parametrize(
    ("name", "geometry"),
    [pair if pair in DEFAULTS else only_all(*pair) for pair in itertools.product(tires.LAWS, GEOMETRIES)],
)
def test_all_backends_drive_the_same_path(name, geometry):
    tire, start = tires.resolve(name), starts()
    reference = np.array([in_python(tire, geometry, row) for row in start])
    assert np.all(np.isfinite(reference))
    assert distance(np.array([in_numba(tire, geometry, row) for row in start]), reference) <= 1e-12
    assert distance(in_numpy(tire, geometry, reference), reference) <= 1e-12
    assert distance(in_torch(tire, geometry, reference), reference) <= 1e-12


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_float32_tensors_stay_float32_and_follow(geometry):
    start = starts()
    orders = np.repeat(commands(15)[:, :, None], len(start), axis=2)
    with torch.inference_mode():
        paths = in_arrays(TORCH, lambda x: torch.from_numpy(x).float(), tires.Fiala(), geometry, start, orders)
    assert paths.dtype == np.float32
    reference = in_arrays(NUMPY, np.asarray, tires.Fiala(), geometry, start, orders)
    assert 1e-9 < distance(paths, reference) <= 1e-4


@pytest.mark.parametrize("name", ["linear", "fiala"])
def test_the_environment_drives_the_same_path(name):
    """BicycleStab-v0 is these laws, at the same steps."""
    env = gym.make("BicycleStab-v0", tire=name, speed_ratio=1.2).unwrapped
    assert (env.control_timestep, env.substeps, env.geometry) == (
        SUBSTEPS * TIMESTEP,
        SUBSTEPS,
        "small_angle" if name == "linear" else "exact",
    )
    advance = law_of(PYTHON, env.tire, env.geometry)
    state = CarState(*starts()[1].tolist())
    env.reset(seed=0, options={"state": state._asdict()})
    for k in range(25):
        action = np.array([np.sin(0.3 * k), np.cos(0.2 * k)], dtype=np.float32)
        command = (float(action[0]) * FRONT.angle_limit, float(action[1]) * REAR.angle_limit)
        for _ in range(SUBSTEPS):
            state = advance(state, command, command, command, CAR, TIMESTEP)
        _, _, terminated, _, _ = env.step(action)
        assert not terminated
        assert distance(np.array(env.state[:FIELDS]), np.array(state, dtype=float)) <= 1e-13


# A fifth law: one class here, one row in the table


@dataclasses.dataclass(frozen=True)
class Arctangent(tires.Tire):
    """Y = -(2/pi) D atan(pi C alpha / (2 D))."""

    def law(self, xp):
        def lateral_force(slip_angle, cornering_stiffness, peak_force):
            steepness = (np.pi / 2) * cornering_stiffness / peak_force
            return (-2.0 / np.pi) * peak_force * xp.atan(slip_angle * steepness)

        return lateral_force


@pytest.fixture
def arctangent(monkeypatch):
    monkeypatch.setitem(tires.LAWS, "arctangent", Arctangent)
    return tires.resolve("arctangent")


def test_a_fifth_law_is_a_tire(arctangent):
    alpha = np.linspace(-1.0, 1.0, 101)
    expected = -(2.0 / np.pi) * 5000.0 * np.arctan(np.pi / 2 * 80e3 * alpha / 5000.0)
    np.testing.assert_allclose(arctangent.lateral_force(alpha, 80e3, 5000.0), expected, rtol=1e-13, atol=1e-10)


def test_a_fifth_law_drives_simulate(arctangent):
    """The middle of a run in the compiled path against the law itself, and not the path of another law."""
    run = simulate("oversteer", 40.0, (0.05, 0.0), 1.0, tire="arctangent")
    expected = arctangent.lateral_force(
        run["front_slip_angle"], OVERSTEER.front_cornering_stiffness, OVERSTEER.front_axle_load
    )
    np.testing.assert_allclose(run["front_lateral_force"], expected, rtol=1e-12)
    np.testing.assert_allclose(
        np.gradient(run["yaw_rate"], run["time"])[5:-5], run["yaw_acceleration"][5:-5], atol=2e-3
    )
    other = simulate("oversteer", 40.0, (0.05, 0.0), 1.0, tire="tanh")
    assert abs(run["yaw_rate"][-1] - other["yaw_rate"][-1]) > 1e-3


def test_a_fifth_law_drives_every_backend(arctangent):
    start = starts(2)
    whole = np.array([in_python(arctangent, "exact", row) for row in start])
    assert distance(np.array([in_numba(arctangent, "exact", row) for row in start]), whole) <= 1e-12
    for in_backend in (in_numpy, in_torch):
        assert distance(in_backend(arctangent, "exact", whole), whole) <= 1e-12


def test_a_fifth_law_drives_the_environment(arctangent):
    env = gym.make("BicycleStab-v0", tire="arctangent").unwrapped
    assert env.tire == arctangent
    advance = law_of(PYTHON, arctangent, "exact")
    state = CarState(*starts()[0].tolist())
    env.reset(seed=0, options={"state": state._asdict()})
    for _ in range(10):
        for _ in range(SUBSTEPS):
            state = advance(state, *[(0.5 * FRONT.angle_limit, 0.0)] * 3, CAR, TIMESTEP)
        env.step(np.array([0.5, 0.0], dtype=np.float32))
    assert distance(np.array(env.state[:FIELDS]), np.array(state, dtype=float)) <= 1e-13


@pytest.mark.parametrize("with_single", [False, only_all(True)])
@pytest.mark.exhaustive
def test_a_fifth_law_drives_many_cars(arctangent, with_single):
    """Row by row the bits of the single environment, close to it in single precision, and the same on tensors."""
    given = {"num_envs": 8, "tire": "arctangent", "autoreset_mode": "Disabled"}
    double = gym.make_vec("BicycleStab-v0", **given)
    single = gym.make_vec("BicycleStab-v0", **given, dtype="float32") if with_single else None
    tensors = TorchVectorEnv("BicycleStab-v0", **given)
    alone = [gym.make("BicycleStab-v0", tire="arctangent").unwrapped for _ in range(8)]
    double.reset(seed=4)
    starts = {name: values for name, values in double.state._asdict().items() if name != "time"}
    for env in (single, tensors):
        if env is not None:
            env.reset(options={"state": starts})
    for row, env in enumerate(alone):
        env.reset(seed=4 + row)
    for k in range(30):
        actions = np.column_stack([np.sin(0.3 * k + np.arange(8)), np.cos(0.2 * k + np.arange(8))]).astype(np.float32)
        observation, reward, terminated, _, _ = double.step(actions)
        assert not terminated.any()
        for row, env in enumerate(alone):
            expected = env.step(actions[row])
            assert (observation[row].tobytes(), reward[row]) == (expected[0].tobytes(), expected[1])
        if single is not None:
            np.testing.assert_allclose(single.step(actions)[0], observation, rtol=0.0, atol=1e-4)
        tensors.step(torch.from_numpy(actions))
    assert distance(np.array(tensors.state), np.array(double.state)) <= 1e-12


def test_a_fifth_law_is_analysed(arctangent):
    """A steady turn found with the law: its forces carry the turn, and simulate() stays in it."""
    steer, speed = (0.01, 0.0), 20.0
    turn = next(turn for turn in analysis.equilibria(OVERSTEER, speed, steer, tire="arctangent") if turn.is_stable)
    front, rear = (
        arctangent.lateral_force(slip, stiffness, load)
        for slip, stiffness, load in (
            (turn.front_slip_angle, OVERSTEER.front_cornering_stiffness, OVERSTEER.front_axle_load),
            (turn.rear_slip_angle, OVERSTEER.rear_cornering_stiffness, OVERSTEER.rear_axle_load),
        )
    )
    centripetal = OVERSTEER.mass * turn.lateral_acceleration
    assert front * np.cos(steer[0]) + rear == pytest.approx(centripetal, rel=1e-9)
    start = {"lateral_velocity": turn.lateral_velocity, "yaw_rate": turn.yaw_rate}
    run = simulate(OVERSTEER, speed, steer, 2.0, tire="arctangent", initial_state=start)
    np.testing.assert_allclose(run["yaw_rate"], turn.yaw_rate, rtol=1e-9)
    other = analysis.equilibria(OVERSTEER, speed, steer, tire="tanh")
    assert all(abs(turn.yaw_rate - each.yaw_rate) > 1e-6 for each in other)


def test_a_name_that_is_no_row_is_refused_and_the_rows_are_listed(arctangent):
    with pytest.raises(ValueError, match=r"'magic_formula', 'arctangent', got 'arctan'; did you mean 'arctangent'\?"):
        bicycle_env.simulate("oversteer", 40.0, (0.0, 0.0), 1.0, tire="arctan")
