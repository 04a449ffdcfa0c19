"""What a user writes without editing the package: each example runs, in every environment, and is trained and drawn."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all
from gymnasium.envs.registration import registry

import bicycle_env
from bicycle_env import control
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.tasks.checking import world_of
from bicycle_env.tasks.episode import EpisodeState
from bicycle_env.tasks.stabilise import Stabilise

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
QUICK = {"tire": "linear", "geometry": "small_angle"}
CARS = 8


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    yield
    for env_id in [name for name in registry if name.startswith("Mine/")]:
        registry.pop(env_id)
    for name in [path.stem for path in EXAMPLES.glob("*.py")]:
        sys.modules.pop(name, None)


def run(*words, folder):
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(EXAMPLES), str(ROOT)])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    "name", [only_all("my_task"), only_all("my_slalom"), only_all("my_reward"), only_all("my_tire")]
)
def test_an_example_runs_as_its_docstring_says(name, tmp_path):
    printed = run(str(EXAMPLES / f"{name}.py"), folder=tmp_path)
    assert "LQR" in printed or "success" in printed or "the same to the bit" in printed
    if "runs/" in (EXAMPLES / f"{name}.py").read_text():
        assert (tmp_path / "runs" / f"{name}.png").stat().st_size > 20_000


@pytest.mark.exhaustive
def test_the_task_is_the_same_for_one_car_many_and_tensors():
    importlib.import_module("my_task")
    env_id = "Mine/Gusty-v0"
    given = {**QUICK, "autoreset_mode": "Disabled", "road_half_width": 1.6}
    many, tensors = gym.make_vec(env_id, CARS, **given), TorchVectorEnv(env_id, CARS, **given)
    alone = [gym.make(env_id, **QUICK, road_half_width=1.6) for _ in range(CARS)]
    many.reset(seed=1)
    for k, env in enumerate(alone):
        env.reset(seed=1 + k)
    tensors.reset(seed=0)
    tensors.set_state({name: torch.from_numpy(values) for name, values in many.unwrapped.state._asdict().items()})
    over, pushed = np.zeros(CARS, bool), 0
    for k in range(110):
        action = np.column_stack([np.sin(0.1 * k + np.arange(CARS)), np.cos(0.1 * k + np.arange(CARS))]) * 0.05
        observation, reward, terminated, truncated, _ = many.step(action.astype(np.float32))
        _, gained, *_ = tensors.step(torch.from_numpy(action.astype(np.float32)))
        for row in np.flatnonzero(~over):
            expected = alone[row].step(action[row].astype(np.float32))
            assert (observation[row].tobytes(), reward[row]) == (expected[0].tobytes(), expected[1])
            assert gained[row].item() == pytest.approx(reward[row], rel=1e-12, abs=1e-12)
            pushed += abs(alone[row].unwrapped.measure()["lateral_acceleration"]) > 1.0
        over |= terminated | truncated
    assert over.any()
    assert pushed > 5


def test_the_narrow_place_is_judged_and_drawn():
    task = importlib.import_module("my_task").Gusty()
    env = gym.make("Mine/Gusty-v0", **QUICK).unwrapped
    for place, half in ((0.0, 1.5), (80.0, 1.05), (70.0, 1.275), (200.0, 1.5)):
        env.reset(seed=0, options={"state": {"longitudinal_position": place}})
        assert env.measure()["reference_road_half_width"] == pytest.approx(half, abs=1e-12)
        corners = [place + env.vehicle.front_extent, place - env.vehicle.rear_extent]  # each at its own place
        edges = [1.5 * (1.0 - 0.3 * max(1.0 - abs(along - 80.0) / 20.0, 0.0)) for along in corners]
        assert env.measure()["clearance"] == pytest.approx(min(edges) - 0.5 * env.vehicle.body_width, abs=1e-12)
    names = [metric.name for metric in task.metrics]
    assert names[-1] == "least_clearance"


def slalom(**fields):
    """The task, a world of it, and its path to the left."""
    module = importlib.import_module("my_slalom")
    task = module.Slalom(**fields)
    return module, task, world_of(task), module.path_of(NUMPY, task.cones)


@pytest.mark.parametrize("cones", [1, 4, 6])
def test_the_slaloms_path_passes_each_cone_on_its_side(cones):
    module, task, world, path = slalom(cones=cones)
    apart = 0.5 * world.car.body_width + module.HALF_CONE + task.margin
    x = task.first_cone + task.spacing * np.arange(-2.0, cones + 2.0)
    y, slope = path(x, module.Run(1.0, module.FAR), world)
    np.testing.assert_allclose(y, [0.0, 0.0, *(apart * (-1.0) ** k for k in range(cones)), 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(slope, 0.0, atol=1e-12)
    x = np.linspace(0.0, 400.0, 40_001)
    y, slope = path(x, module.Run(1.0, module.FAR), world)
    np.testing.assert_allclose(np.gradient(y, x)[1:-1], slope[1:-1], atol=1e-3)


def test_the_slalom_tells_the_next_cone_and_knows_the_touched():
    module, task, world, path = slalom()
    cone, remember = module.next_cone(NUMPY, task.cones), task.remember(NUMPY)
    for place, expected in (
        (0.0, (50.0, 1.0)),
        (50.0 + 1.9, (50.0, 1.0)),
        (53.0, (86.0, -1.0)),
        (400.0, (230.0, -1.0)),
    ):
        assert cone(place, world.settings, 1.0, 2.0) == expected
    run = module.Run(1.0, module.FAR)
    for x, beside in ((50.0, True), (86.0, True), (68.0, False)):  # the path runs straight at the cones
        y, slope = path(x, run, world)
        state = CarState(x, y, np.arctan(slope), *(0.0,) * 4)
        for across, clearance in ((0.0, 0.45), (-np.sign(y) * 0.5, -0.05)):
            found = remember(
                state._replace(lateral_position=y + across), EpisodeState(0.0, 0.0, 0, 0, run), None, world
            )
            assert found.least_clearance == pytest.approx(clearance if beside else module.FAR, abs=1e-12)


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore:no weights were tuned:UserWarning")
def test_the_slalom_is_passed_by_followers_of_its_path_and_not_by_chance():
    importlib.import_module("my_slalom")
    for direction in (1, "right"):
        for name, word, passed in (("lqr", "", True), ("stanley", "", True), ("zero", "hit_cone", False)):
            env = gym.make("Mine/Slalom-v0")
            policy = control.make(name, env)
            observation, _ = env.reset(seed=5, options={"direction": direction})
            over = False
            while not over:
                observation, _, terminated, truncated, info = env.step(policy.act(observation))
                over = terminated or truncated
            assert (info["end"], info["is_success"]) == (word, passed)
    env.reset(seed=0, options={"state": {"longitudinal_position": 300.0}})
    assert env.step(np.zeros(1, np.float32))[4]["end"] == "hit_cone", "a car put behind the cones has passed none"


@pytest.mark.exhaustive
@pytest.mark.parametrize("level", ["medium", "hard"])
def test_the_slalom_keeps_what_every_environment_promises(level):
    importlib.import_module("my_slalom")
    assert len(bicycle_env.check_task("Mine/Slalom-v0", cars=4, level=level)) == 4


def test_the_reward_is_paid():
    alive = importlib.import_module("my_reward").Alive(price=2.0)
    env = gym.make("BicycleStab-v0", **QUICK, reward=alive).unwrapped
    env.reset(seed=2)
    reward = env.step(np.zeros(2, np.float32))[1]
    assert reward == pytest.approx(1.0 - 2.0 * max(abs(env.state.lateral_velocity) / env.speed - 0.1, 0.0), rel=1e-12)


def test_the_tire_is_linear_up_to_half_its_peak_and_stays_below_it():
    law = importlib.import_module("my_tire").Dugoff().law(NUMPY)
    slip = np.linspace(-0.5, 0.5, 201)
    force = law(slip, 1e5, 4e3)
    linear = abs(slip) <= 0.02
    np.testing.assert_allclose(force[linear], -1e5 * slip[linear], rtol=1e-12)
    np.testing.assert_array_equal(law(-slip, 1e5, 4e3), -force)
    assert (abs(force) < 4e3).all()
    assert (np.diff(force) < 0.0).all()


def test_the_controller_is_made_by_its_name():
    env = gym.make("BicycleStab-v0", **QUICK, steer="rear")
    policy = control.make("my_controller:YawDamper", env)
    assert policy.act(np.zeros((3, 8), np.float32)).shape == (3, 1)
    with pytest.raises(ValueError, match="did you mean 'YawDamper'"):
        control.make("my_controller:YawDampr", env)
    with pytest.raises(ValueError, match="the module 'my_controler' cannot be imported"):
        control.make("my_controler:YawDamper", env)


@pytest.mark.exhaustive
def test_the_task_is_trained_and_evaluated_beside_ones_own_controller(tmp_path):
    env_id = "my_task:Mine/Gusty-v0"
    words = ("--env-id", env_id, "--algo", "ppo", "--total-timesteps", "20000", "--out", "gusty")
    run("-m", "agents.train", *words, folder=tmp_path)
    policies = ("--policy", "gusty", "lqr", "my_controller:YawDamper", "--episodes", "3", "--json", "figures.json")
    printed = run("-m", "agents.evaluate", "--env-id", env_id, *policies, folder=tmp_path)
    assert "clearance" in printed
    figures = json.loads((tmp_path / "figures.json").read_text())["policies"]
    assert set(figures) == {"gusty", "lqr", "my_controller:YawDamper"}
    assert figures["lqr"]["least_clearance"]["value"] > 0.0


def test_a_law_that_numba_cannot_compile_is_one_line():
    class Starred(Stabilise):
        def observe(self, xp):
            def observe(state, episode, world):
                return tuple([state.heading] * 8)

            return observe

    import dataclasses

    from bicycle_env.backends.compiled import LawError
    from bicycle_env.envs import BicycleStabEnv

    class Env(BicycleStabEnv):
        default_task = dataclasses.dataclass(frozen=True)(Starred)()

    with pytest.raises(LawError, match=r"test_examples.py, line \d+: this law cannot be compiled \(") as error:
        Env(**QUICK).reset()
    assert "\n" not in str(error.value)
    assert "\n" in error.value.details
