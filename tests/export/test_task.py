"""Whole tasks in C and JavaScript: equal to the laws in plain Python to the bit, and to the environment."""

import dataclasses
import itertools
import json

import gymnasium as gym
import numpy as np
import pytest
from building import NODE, c_test, js_test, needs_gcc, needs_node, run
from combinations import only_all

from bicycle_env import export, register
from bicycle_env.backends.trace import TraceError
from bicycle_env.export import task
from bicycle_env.registration import ENVIRONMENTS
from bicycle_env.tasks.disturbances import Gust
from bicycle_env.tasks.stabilise import Stabilise

NAME = "bicycle_task"
ENDS = task.configuration_of("BicycleStab-v0").end_names
IDS = [row.id for row in ENVIRONMENTS]
CASES = {
    **{env_id: (env_id, {}) for env_id in IDS},
    "altered": (
        "BicycleLaneChange-v0",
        {
            "tire": "magic_formula",
            "relaxation_length": 0.4,
            "reward": "quadratic",
            "steer": "rear",
            "driver": "step",
            "action_delay": 2,
            "disturbances": (Gust(start=0.109),),  # within the sixth step, of which there is a vector
            "history": 2,
        },
    ),
}


@needs_node
@pytest.mark.parametrize("name", CASES)
def test_javascript_gives_the_laws_bits(name, tmp_path):
    env_id, keywords = CASES[name]
    export.export_task(env_id, "js", tmp_path, **keywords)
    code, said = js_test(tmp_path, NAME)
    assert (code, said.startswith("0 of ")) == (0, True), said


@needs_gcc
@pytest.mark.parametrize(
    ("name", "fma"),
    [
        (IDS[0], False),
        *(only_all(*case) for case in zip(IDS[1:], itertools.cycle((True, False)))),
        ("altered", True),
    ],
)
def test_c_gives_the_laws_bits(name, fma, tmp_path):
    env_id, keywords = CASES[name]
    export.export_task(env_id, "c", tmp_path, fma=fma, **keywords)
    code, said = c_test(tmp_path, NAME)
    assert (code, said.startswith("0 of ")) == (0, True), said


EPISODE = """
import * as task from "./bicycle_task.mjs";
import { readFileSync } from "node:fs";
const { uniforms, actions } = JSON.parse(readFileSync("given.json"));
const state = task.new_state(), episode = task.new_episode(), outcome = task.new_outcome();
const { exported_car: car, exported_rules: rules, exported_settings: settings } = task;
task.start(state, episode, Object.fromEntries(uniforms.map((u, k) => [`u${k}`, u])), car, rules, settings);
const observation = task.new_observation(), rows = [];
for (const [front, rear] of actions) {
  task.step(state, episode, outcome, state, episode, { front, rear }, car, rules, settings);
  task.observe(observation, state, episode, task.exported_scale, car, rules, settings);
  rows.push([...Object.values(observation), outcome.reward, outcome.end, outcome.cost]);
}
console.log(JSON.stringify({ rows, word: task.end_words[outcome.end] }));
"""


@needs_node
@pytest.mark.parametrize("steer", ["front", "rear"])
def test_an_episode_in_javascript_is_the_environments(steer, tmp_path):
    """To rounding: the environment's multiply-add rounds once."""
    env = gym.make("BicycleStab-v0", steer=steer).unwrapped
    env.reset(seed=5)
    uniforms = np.random.Generator(np.random.PCG64(5)).random(4)
    actions = np.random.default_rng(5).uniform(-1.0, 1.0, (200, 2)).astype(np.float32)
    rows = []
    for action in actions:
        observation, reward, over, _, info = env.step(action[:1] if steer == "front" else action[1:])
        rows.append([*observation.tolist(), reward, float(ENDS.index(info["end"])), info["cost"]])
        if over:
            break
    export.export_task("BicycleStab-v0", "js", tmp_path, steer=steer)
    (tmp_path / "episode.mjs").write_text(EPISODE)
    given = {"uniforms": uniforms.tolist(), "actions": actions[: len(rows)].tolist()}
    (tmp_path / "given.json").write_text(json.dumps(given))
    code, said = run(NODE, "episode.mjs", folder=tmp_path)
    assert code == 0, said
    found = json.loads(said)
    assert found["word"] == info["end"] != ""
    assert len(rows) > 20
    np.testing.assert_allclose(found["rows"], rows, rtol=1e-6, atol=1e-6)


def test_what_depends_on_the_speed_can_be_asked_for():
    names = [routine.name for routine in task.routines(task.configuration_of("BicycleDoubleLaneChange-v0"))]
    assert {"scales", "settings_at"} <= set(names)


def test_noise_is_refused_in_words(tmp_path):
    with pytest.raises(TraceError, match="bits of integers"):
        export.export_task("BicycleStab-v0", "js", tmp_path, sensors={"noise": {"yaw_rate": 0.01}})


@dataclasses.dataclass(frozen=True)
class Wide(Stabilise):
    """Catch the car on a wide road."""

    road_half_width: float = 3.125


def test_a_task_of_ones_own(tmp_path):
    register("Mine/Exported-v0", Wide)
    export.export_task("Mine/Exported-v0", "js", tmp_path, level="easy")
    assert "car_body_width + 3.125" in (tmp_path / f"{NAME}.mjs").read_text()


def test_an_environment_of_others_is_refused(tmp_path):
    with pytest.raises(ValueError, match="env_id must be an environment of this package"):
        export.export_task("CartPole-v1", "js", tmp_path)
