"""Keywords of gym.make_vec and options of reset for many cars: what is accepted, and that a refusal changes nothing."""

import math

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all
from test_reset_options import BAD_LANE_CHANGE, BAD_OPTIONS
from vector_cases import FEW, IDS, LANE_CHANGE, MANY, STAB, actions_for, compiled, drive, everything, record

from bicycle_env import Actuator

NUMBER = 6


def make(env_id=STAB, **keywords):
    return gym.make_vec(env_id, **{"num_envs": NUMBER, "max_episode_steps": 40, **compiled(env_id, NUMBER), **keywords})


def twins(env_id=STAB, **keywords):
    pair = [make(env_id, **keywords) for _ in range(2)]
    for env in pair:
        env.reset(seed=31)
        drive(env, actions_for(env, 7))
    return pair


def assert_still_twins(env, twin):
    assert record(env.state) == record(twin.state)
    assert everything(env) == everything(twin)
    actions = actions_for(env, 3)
    assert drive(env, actions) == drive(twin, actions)
    assert record(env.reset()) == record(twin.reset())


# Options


def column(value, row=4, dtype=float):
    values = np.zeros(NUMBER, dtype)
    values[row] = value
    return values


def state(**values):
    return {"state": values}


def is_for_one_car(options):
    """Whether the single environment refuses it for being an array, which many cars may give."""
    given = options.get("state") if isinstance(options, dict) else None
    return isinstance(given, dict) and any(np.ndim(value) for value in given.values())


BOTH = [case for case in BAD_OPTIONS if not is_for_one_car(case[0])]
COLUMNS = [
    (state(yaw_rate=column(math.nan)), ValueError, "yaw_rate.*got nan"),
    (state(yaw_rate=column(math.inf)), ValueError, "yaw_rate.*got inf"),
    (state(yaw_rate=column(-math.inf)), ValueError, "yaw_rate.*got -inf"),
    (state(yaw_rate=column(11.0)), ValueError, r"yaw_rate.*\[-10, 10\], got 11"),
    (state(yaw_rate=column(-11)), ValueError, "yaw_rate.*got -11"),
    (state(front_steer=column(0.2).tolist()), ValueError, "front_steer.*got 0.2"),
    (state(rear_steer_command=column(-0.053)), ValueError, "rear_steer_command"),
    (state(heading=0.0, yaw_rate=column(0.1), rear_steer=column(math.nan)), ValueError, "rear_steer"),
    (state(yaw_rate=np.zeros(5)), ValueError, r"yaw_rate.*num_envs = 6 of them, got shape \(5,\)"),
    (state(yaw_rate=[0.1]), ValueError, r"yaw_rate.*got shape \(1,\)"),
    (state(yaw_rate=np.zeros((6, 1))), ValueError, r"yaw_rate.*got shape \(6, 1\)"),
    (state(yaw_rate=[]), ValueError, r"yaw_rate.*got shape \(0,\)"),
    (state(yaw_rate=np.zeros(6, bool)), TypeError, "yaw_rate.*num_envs = 6"),
    (state(yaw_rate=np.zeros(6, complex)), TypeError, "yaw_rate.*num_envs = 6"),
    (state(yaw_rate=["0.1"] * 6), TypeError, "yaw_rate.*num_envs = 6"),
    (state(yaw_rate=[None] * 6), TypeError, "yaw_rate.*num_envs = 6"),
    (state(yaw_rate=[[0.1]] * 5 + [[0.1, 0.2]]), TypeError, "yaw_rate.*num_envs = 6"),
    (state(yaw_rat=column(0.1)), ValueError, "unknown state name 'yaw_rat'; did you mean 'yaw_rate'"),
    (state(time=column(0.1)), ValueError, "unknown state name 'time'"),
]
ROUTES = [
    ({"direction": ["left"] * 5}, ValueError, r"direction'\] must be one word or num_envs = 6 of them, got 5"),
    ({"direction": ["left"] * 5 + ["lefft"]}, ValueError, r"direction'\]\[5\] .*got 'lefft'; did you mean 'left'"),
    ({"direction": ["left"] * 5 + ["random"]}, ValueError, r"direction'\]\[5\]"),
    ({"direction": np.full(6, 0.5)}, TypeError, r"direction'\]\[0\] must be one of 'left', 'right'"),
    ({"change_start": column(-0.1)}, ValueError, r"change_start.*\[0, 100\], got -0.1"),
    ({"change_start": column(100.5)}, ValueError, r"change_start.*\[0, 100\], got 100.5"),
    ({"change_start": column(math.nan)}, ValueError, "change_start.*got nan"),
    ({"change_start": np.zeros(5)}, ValueError, r"change_start.*num_envs = 6 of them, got shape \(5,\)"),
    ({"change_start": ["1"] * 6}, TypeError, "change_start.*num_envs = 6 of them"),
]
GRADIENT = torch.zeros(6, requires_grad=True)
MASKS = [
    (np.zeros(6, bool), ValueError, "at least one True"),
    (np.ones(5, bool), ValueError, r"shape \(6,\)"),
    (np.ones((6, 1), bool), ValueError, r"shape \(6,\)"),
    (np.ones(6), TypeError, "array of bool"),
    (np.ones(6, np.int8), TypeError, "array of bool"),
    ([True] * 6, TypeError, "array of bool"),
    (True, TypeError, "array of bool"),
]
CASES = [
    *((env_id, *case) for env_id in IDS for case in (*BOTH, *COLUMNS)),
    *((STAB, {"reset_mask": mask}, error, match) for mask, error, match in MASKS),
    *((LANE_CHANGE, *case) for case in (*BAD_LANE_CHANGE, *ROUTES)),
    (STAB, state(yaw_rate=GRADIENT), TypeError, "yaw_rate.*num_envs = 6 of them, got tensor"),
    (STAB, {"reset_masks": np.ones(6, bool)}, ValueError, "unknown reset option 'reset_masks'"),
    (STAB, {"reset_mask": np.ones(6, bool), "stat": {}}, ValueError, "'stat'; did you mean 'state'"),
]


@pytest.mark.parametrize(("env_id", "options", "error", "match"), CASES)
def test_a_refused_reset_changes_nothing(env_id, options, error, match):
    env, twin = twins(env_id)
    with pytest.raises(error, match=match):
        env.reset(seed=99, options=options)
    assert_still_twins(env, twin)


def test_a_refused_first_reset_leaves_the_environment_unstarted():
    env = make()
    for options, error in (
        ({"state": {"yaw_rate": math.nan}}, ValueError),
        ({"reset_mask": column(True, dtype=bool)}, gym.error.ResetNeeded),
    ):
        with pytest.raises(error):
            env.reset(seed=0, options=options)
        with pytest.raises(gym.error.ResetNeeded):
            env.step(np.zeros((NUMBER, 2), np.float32))
    assert record(env.reset(seed=3)) == record(make().reset(seed=3))


@pytest.mark.parametrize("env_id", IDS)
def test_a_state_of_numbers_and_arrays_is_the_single_environments(env_id):
    env = make(env_id)
    given = {
        "longitudinal_position": 12,
        "lateral_position": column(-0.4),
        "heading": np.float32(0.1),
        "lateral_velocity": column(-2, dtype=int),
        "yaw_rate": np.linspace(-0.3, 0.3, NUMBER).astype(np.float32),
        "front_steer": column(0.1).tolist(),
        "rear_steer_command": (0.01, 0.0, -0.01, 0.02, 0.0, 0.05),
    }
    sides = {"direction": "right", "change_start": 0.4} if env_id == LANE_CHANGE else {}
    observation, info = env.reset(seed=6, options={"state": given, **sides})
    for row in range(NUMBER):
        alone = gym.make(env_id, **compiled(env_id)).unwrapped
        mine = {name: np.broadcast_to(value, NUMBER)[row] for name, value in given.items()}
        expected, expected_info = alone.reset(seed=6 + row, options={"state": mine, **sides})
        assert observation[row].tobytes() == expected.tobytes()
        assert info["cost"][row] == expected_info["cost"]
        assert tuple(values[row] for values in env.state) == alone.state


def test_a_start_takes_the_same_random_numbers_with_options_or_without():
    env, twin = make(LANE_CHANGE), make(LANE_CHANGE)
    env.reset(seed=5, options={**state(yaw_rate=column(0.1)), "direction": "left"})
    twin.reset(seed=5)
    assert record(env.reset()) == record(twin.reset())


def test_the_change_of_lane_begins_at_each_cars_own_place():
    """change_start is a time: the place depends on the speed."""
    env = make(LANE_CHANGE, speed=[20.0, 30.0, 40.0, 20.0, 30.0, 40.0])
    env.reset(options={"change_start": 0.5})
    assert env.state.change_start.tolist() == [10.0, 15.0, 20.0] * 2


SIDES = ["left", "right", "right", "left", "right", "left"]
BEGINS = [0.0, 0.5, 1.0, 1.5, 2.0, 100.0]


@pytest.mark.parametrize("different", [False, True], ids=["alike", "different"])
@pytest.mark.parametrize("kind", [list, tuple, np.array])
def test_each_car_changes_to_its_own_side_at_its_own_time(kind, different):
    # Two kinds that are compiled for each row's comparison with its single environment, too.
    law = {"tire": "tanh"} if different else {"tire": "magic_formula", "geometry": "small_angle"}
    number = FEW if different else MANY
    speeds = {"speed": np.linspace(30.0, 40.0, number)} if different else {}
    sides, begins = np.resize(SIDES, number).tolist(), np.resize(BEGINS, number).tolist()
    env = gym.make_vec(LANE_CHANGE, number, **speeds, **law)
    observation, _ = env.reset(seed=4, options={"direction": kind(sides), "change_start": kind(begins)})
    for row in (*range(len(SIDES)), number - 1):
        mine = {name: values[row] for name, values in speeds.items()}
        alone = gym.make(LANE_CHANGE, **mine, **law).unwrapped
        expected, _ = alone.reset(seed=4 + row, options={"direction": sides[row], "change_start": begins[row]})
        assert observation[row].tobytes() == expected.tobytes()
        assert tuple(values[row] for values in env.state) == alone.state


def test_with_a_mask_only_its_rows_take_the_values():
    env, twin = twins(LANE_CHANGE)
    mask = np.array([True, False, False, True, True, False])
    before = env.state
    env.reset(options={"reset_mask": mask, "direction": SIDES, "change_start": BEGINS})
    expected = np.where(mask, [1.0 if side == "left" else -1.0 for side in SIDES], before.direction)
    assert env.state.direction.tolist() == expected.tolist()
    assert np.array_equal(env.state.change_start, np.where(mask, np.multiply(BEGINS, env.speed), before.change_start))
    kept = ~mask
    for values, others in zip(env.state, twin.state, strict=True):
        assert np.array_equal(values[kept], others[kept])


def test_a_mask_may_be_a_view_and_stays_the_callers():
    env, twin = twins()
    wide = np.array([True, False] * NUMBER)
    given = {"reset_mask": wide[::2]}
    results = env.reset(seed=1, options=given)
    assert given["reset_mask"].tolist() == wide[::2].tolist() == [True] * NUMBER
    twin.reset(seed=1, options={"reset_mask": np.ones(NUMBER, bool)})
    for value in (results[0], *results[1].values()):
        assert not np.shares_memory(value, wide)
    wide[:] = False
    assert_still_twins(env, twin)


@pytest.mark.parametrize("dtype", ["float64", only_all("float32")])
def test_a_state_can_be_given_back(dtype):
    """Also a steer angle at its limit, which float32 rounds up."""
    env = make(dtype=dtype)
    limits = {"front_steer": env.front_actuator.angle_limit, "rear_steer_command": -env.rear_actuator.angle_limit}
    env.reset(seed=0, options={"state": limits})
    kept = {name: values for name, values in env.state._asdict().items() if name != "time"}
    env.reset(options={"state": kept})
    assert all(np.array_equal(values, kept[name]) for name, values in env.state._asdict().items() if name != "time")


def test_the_limits_of_the_steer_angles_are_those_of_the_actuators():
    env = make(rear_actuator=Actuator(0.3))
    env.reset(options=state(rear_steer=column(-0.3)))
    assert env.state.rear_steer[4] == -0.3
    with pytest.raises(ValueError, match="rear_steer"):
        env.reset(options=state(rear_steer=column(-0.31)))


# Keywords


@pytest.mark.parametrize(
    ("keywords", "error", "match"),
    [
        ({"num_envs": 0}, ValueError, r"num_envs must be a whole number in \[1,"),
        ({"num_envs": -1}, ValueError, "num_envs"),
        ({"num_envs": 2.0}, TypeError, "num_envs"),
        ({"num_envs": True}, TypeError, "num_envs"),
        ({"threads": 0}, ValueError, r"threads must be a whole number in \[1, 1024\], got 0"),
        ({"threads": 1.5}, TypeError, "threads"),
        ({"threads": None}, TypeError, "threads"),
        ({"dtype": "float16"}, ValueError, "dtype must be one of 'float64', 'float32', got 'float16'; did you mean"),
        ({"dtype": np.float32}, TypeError, "dtype"),
        ({"autoreset_mode": "Nextstep"}, ValueError, "autoreset_mode must be one of.*did you mean 'NextStep'"),
        ({"autoreset_mode": None}, TypeError, "autoreset_mode"),
        ({"max_episode_steps": 0}, ValueError, "max_episode_steps"),
        ({"max_episode_steps": -2}, ValueError, "max_episode_steps"),
        ({"max_episode_steps": 10.0}, TypeError, "max_episode_steps"),
        ({"max_episode_steps": 2**24 + 1, "dtype": "float32"}, ValueError, r"max_episode_steps .*\[1, 16777216\]"),
        ({"on_invalid": "ignore"}, ValueError, "on_invalid must be one of 'raise', 'terminate'"),
        ({"staggered_start": 1}, TypeError, "staggered_start must be True or False"),
        ({"telemetry": "yes"}, TypeError, "telemetry must be True or False"),
        ({"render_mode": "human"}, ValueError, "render_mode must be one of 'rgb_array', got 'human'"),
        ({"friktion": 0.5}, TypeError, "unknown keyword 'friktion'; did you mean 'friction'"),
        ({"staggered": True}, TypeError, "unknown keyword 'staggered'; did you mean 'staggered_start'"),
        ({"friction": GRADIENT}, TypeError, "friction must be one number or num_envs = 6 of them, got tensor"),
        ({"friction": [0.5] * 5}, ValueError, "friction must be one number or num_envs = 6 of them"),
        ({"friction": [0.5] * 5 + [-1.0]}, ValueError, "car 5: friction"),
        ({"speed": [30.0] * 6, "speed_ratio": 1.1}, ValueError, "speed or speed_ratio"),
        ({"vehicle": ["oversteer"] * 5 + ["oversteeer"]}, ValueError, "did you mean 'oversteer'"),
        ({"tire": "fialla"}, ValueError, "did you mean 'fiala'"),
        ({"tire": ["fiala"] * 6}, TypeError, "tire"),
        ({"steer": "all"}, ValueError, "steer must be one of"),
        ({"physics_timestep": 0.003}, ValueError, "physics_timestep must divide"),
    ],
    ids=str,
)
@pytest.mark.parametrize("env_id", IDS)
def test_a_bad_keyword_is_named(env_id, keywords, error, match):
    with pytest.raises(error, match=match):
        gym.make_vec(env_id, **{"num_envs": NUMBER, **keywords})


def test_a_keyword_of_the_other_task_is_refused():
    with pytest.raises(TypeError, match="unknown keyword 'direction'"):
        make(STAB, direction="left")
    env = make(LANE_CHANGE, direction="left")
    env.reset(seed=0)
    assert (env.state.direction == 1.0).all()


def test_every_keyword_of_the_single_environment_is_one_here():
    keywords = {
        "vehicle": "me303",
        "tire": "magic_formula",
        "speed": 20.0,
        "steer": "rear",
        "friction": 0.8,
        "geometry": "exact",
        "relaxation_length": None,
        "front_actuator": Actuator(0.2),
        "rear_actuator": Actuator(0.1),
        "control_timestep": 0.04,
        "physics_timestep": 0.008,
        "reward": "quadratic",
        "horizon": 33,
    }
    # Compiled for these tests already: with numbers of each row's own.
    limit = {"max_episode_steps": 33}
    env = make(**{**keywords, "friction": [0.8] * NUMBER}, **limit, telemetry=True)
    alone = gym.make(STAB, **keywords, **limit)
    env.reset(seed=0)
    alone.reset(seed=0)
    for name, value in keywords.items():
        assert getattr(env.configuration, name) == getattr(alone.unwrapped, name), (name, value)
    for action in actions_for(env, 30):
        observation, reward, terminated, _, info = env.step(action)
        expected = alone.step(action[0])
        assert (observation[0].tobytes(), reward[0], terminated[0]) == (expected[0].tobytes(), *expected[1:3])
        assert env.end_names[info["end"][0]] == expected[4]["end"]
        if terminated[0]:
            break
