"""Pictures of the cars of a vector environment, and the recorders that ask for them."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers.vector import RecordVideo

import bicycle_env
from bicycle_env.envs.many.drawn_rows import Row
from bicycle_env.rendering.viewer import HEIGHT, WIDTH

STAB = "BicycleStab-v0"
ROWS = 4
ACTIONS = np.full((ROWS, 2), 0.1, np.float32)


def many(**keywords):
    return gym.make_vec(STAB, ROWS, **{"render_mode": "rgb_array", **keywords})


@pytest.mark.exhaustive
def test_a_row_is_drawn_as_the_single_environment_is():
    envs, one = many(render_rows=(2, 0)), gym.make(STAB, render_mode="rgb_array")
    envs.reset(seed=5)
    one.reset(seed=7)
    for _ in range(3):
        pictures = envs.render()
        assert np.array_equal(pictures[2], one.render())
        envs.step(ACTIONS)
        one.step(ACTIONS[0])
    assert np.any(pictures[0] != pictures[2])
    assert len(pictures) == ROWS
    for row in (1, 3):
        assert pictures[row].shape == (HEIGHT, WIDTH, 3)
        assert not pictures[row].any()
    assert envs.metadata["render_fps"] == one.metadata["render_fps"] == 50
    one.close()


@pytest.mark.exhaustive
def test_a_car_of_ones_own_is_drawn_as_it_is():
    long = bicycle_env.vehicles["oversteer"]
    wide = {"body_width": 2.4, "rear_overhang": 1.7, "mass": 1.1 * long.mass}
    envs = many(varied=True, friction=[1.0, 0.9, 0.8, 0.7])
    envs.reset(seed=0)
    plant = envs.unwrapped
    row = Row(plant, plant._rows, 1)
    assert row.present.vehicle is plant.vehicle[1]
    assert row.present.car.front_peak_force == pytest.approx(0.9 * long.front_axle_load)
    other = bicycle_env.Vehicle(**{**{n: getattr(long, n) for n in FIELDS}, **wide})
    envs.reset(seed=0, options={"vehicle": other, "reset_mask": np.array([False, True, False, False])})
    assert row.present.vehicle.body_length == pytest.approx(other.body_length)
    assert row.present.vehicle.critical_speed == pytest.approx(other.critical_speed)
    assert row.present.vehicle.body_width == 2.4
    assert envs.render()[0].any()


FIELDS = (
    *("mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "front_cornering_stiffness", "rear_cornering_stiffness"),
    *("front_overhang", "body_width"),
)


@pytest.mark.parametrize(("mode", "left"), [("NextStep", [0, 1]), ("SameStep", [0, 1, 2])])
def test_the_path_of_the_episode_before_is_forgotten(mode, left):
    envs = many(autoreset_mode=mode, max_episode_steps=3)
    envs.reset(seed=1)
    for _ in range(5):
        envs.step(0.0 * ACTIONS)
        envs.render()
    assert [round(50 * moment.time) for moment in envs.unwrapped._viewers[0]._history] == left


def test_the_path_of_an_episode_that_was_not_drawn_to_its_end_is_forgotten():
    envs = many(max_episode_steps=3)
    envs.reset(seed=1)
    envs.render()
    for _ in range(6):
        envs.step(0.0 * ACTIONS)
    envs.render()
    assert len(envs.unwrapped._viewers[0]._history) == 1


def test_it_is_refused_what_cannot_be_drawn():
    with pytest.raises(ValueError, match="render_mode must be one of 'rgb_array', got 'human'"):
        many(render_mode="human")
    with pytest.raises(ValueError, match=r"render_rows\[1\] must be a whole number in \[0, 3\], got 4"):
        many(render_rows=(0, 4))
    with pytest.raises(TypeError, match="render_rows must be a sequence of rows"):
        many(render_rows=0)
    envs = many()
    with pytest.raises(gym.error.ResetNeeded):
        envs.render()
    envs.reset(seed=0)
    envs.close()
    with pytest.raises(gym.error.ClosedEnvironmentError):
        envs.render()


def test_without_a_mode_it_says_how_to_get_one(monkeypatch):
    said = []
    monkeypatch.setattr(gym.logger, "warn", said.append)
    envs = many(render_mode=None)
    envs.reset(seed=0)
    assert envs.render() is None
    assert "gym.make_vec" in said[0]


@pytest.mark.parametrize("first_only", [True, False])
def test_gymnasium_records_it(films, tmp_path, first_only):
    rows = (0,) if first_only else range(ROWS)
    envs = RecordVideo(
        many(render_rows=rows), str(tmp_path / "films"), record_first_only=first_only, episode_trigger=lambda _: True
    )
    envs.reset(seed=0)
    for _ in range(3):
        envs.step(ACTIONS)
    envs.close()
    ((frames, fps),) = films
    assert len(frames) == 4
    assert fps == 50
    tiles = 1 if first_only else 2
    assert frames[0].shape == (tiles * HEIGHT, tiles * WIDTH, 3)
    assert np.any(frames[0] != frames[3])
