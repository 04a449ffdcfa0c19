"""Policies from files in the commands: their environment keywords, and what is refused before any work."""

import dataclasses
import json
import sys

import gymnasium as gym
import numpy as np
import pytest
from combinations import some_of

import bicycle_env
from agents import episodes, evaluate, messages, trained
from agents.episodes import Episode
from agents.messages import UserError
from bicycle_env import Vehicle, control, tires, vehicles
from bicycle_env.envs import BicycleLaneChangeEnv, BicycleStabEnv

NAMES = list(gym.make("BicycleStab-v0").unwrapped.observation_names)
SLOW = {"speed_ratio": 1.1, "steer": "both"}


def save(folder, names=NAMES, axles=2, **description):
    layer = np.zeros((axles, len(names)), np.float32), np.zeros(axles, np.float32)
    content = {"env_id": "BicycleStab-v0", "observation_names": names, **description}
    control.Network([layer], "tanh", "clip", content).save(folder)
    return str(folder)


@pytest.fixture
def run(monkeypatch, capsys):
    """agents.evaluate in this process, with driving replaced: gives the environments that would have been driven."""

    def command(*words):
        driven = []

        def drive(env, policy, episodes, seed, tell):
            driven.append(env.spec.kwargs)
            return [Episode(True, True, "", 1.0, {"peak_sideslip": 0.0})] * episodes

        monkeypatch.setattr(evaluate, "evaluate", drive)
        monkeypatch.setattr(sys, "argv", ["evaluate", "--episodes", "2", *words])
        evaluate.main()
        return driven, capsys.readouterr().out

    return command


def test_the_keywords_of_training_serve_the_whole_table(tmp_path, run):
    a, b = (save(tmp_path / name, env_keywords=SLOW) for name in "ab")
    driven, printed = run("--policy", a, "lqr", b)
    assert driven == [{**SLOW, "telemetry": True}] * 3
    assert 'as in training: {"speed_ratio": 1.1, "steer": "both"}' in " ".join(printed.split())
    assert "note:" not in printed


def test_a_policy_without_keywords_drives_the_default(tmp_path, run):
    assert run("--policy", save(tmp_path))[0] == [{"telemetry": True}]


def test_explicit_keywords_win_with_a_note(tmp_path, run):
    driven, printed = run("--policy", save(tmp_path, env_keywords=SLOW), "--env-keywords", "{}")
    assert driven == [{"telemetry": True}]
    assert "was trained with the environment keywords" in " ".join(printed.split())


def test_policies_that_differ_need_a_choice(tmp_path, run):
    a, b = save(tmp_path / "a", env_keywords=SLOW), save(tmp_path / "b")
    with pytest.raises(UserError, match="different keywords; choose with --env-keywords") as caught:
        run("--policy", a, b)
    assert '"speed_ratio": 1.1' in str(caught.value)
    assert len(run("--policy", a, b, "--env-keywords", '{"speed_ratio": 1.1}')[0]) == 2


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"vehicle": "car.toml"}, "vehicle must be a word, not the name of a file"),
        ({"vehicle": "/etc/passwd"}, "vehicle must be a word"),
        ({"vehicle": {"mass": 1.0, "front": "a.json"}}, "front must be a word"),
        ({"tire": "os:system"}, "tire must be a word"),
        ({"tire": {"name": "a.b"}}, None),
        ({"tire": "x" * 41}, "tire must be a word"),
        ({"tire": ""}, "tire must be a word"),
        ({"friction": [1.0]}, "friction must be a number, a word or a table, got a list"),
        ({"render_mode": "human"}, "'render_mode' is no keyword that a policy's file may set"),
        ({"id": "CartPole-v1"}, "'id' is no keyword"),
        ({"entry_point": "os:system"}, "'entry_point' is no keyword"),
        ({"additional_wrappers": 3}, "'additional_wrappers' is no keyword"),
        ({"self": 1}, "'self' is no keyword"),
        ({"task_keywords": {}}, "'task_keywords' is no keyword"),
        ({"\x1b[2J": 1}, r"'\x1b[2J' is no keyword"),
        ({"steer": "\x1b[31m"}, r"got '\x1b[31m'"),
        ({"lane_width": 3.5}, "'lane_width' is no keyword"),
    ],
    ids=str,
)
def test_a_policys_file_gives_plain_values_only(tmp_path, keywords, words):
    network = trained.load(save(tmp_path, env_keywords=keywords))
    if words is None:
        assert trained.keywords_of("x", network, BicycleStabEnv) == keywords
        return
    with pytest.raises(UserError) as caught:
        trained.keywords_of("x", network, BicycleStabEnv)
    assert words in str(caught.value)
    assert str(caught.value).startswith("x: env_keywords: ")
    assert str(caught.value).isprintable()


def test_what_a_policys_file_may_set(tmp_path):
    keywords = {"vehicle": {"mass": 1500, "source": "a/b.toml, p. 3"}, "friction": 0.5, "max_episode_steps": 9}
    network = trained.load(save(tmp_path, env_keywords=keywords))
    assert trained.keywords_of("x", network, BicycleStabEnv) == keywords
    assert trained.keywords_of("x", network, BicycleLaneChangeEnv) == keywords


def test_a_value_out_of_range_is_the_environments_one_line(tmp_path, run):
    with pytest.raises(UserError, match="BicycleStab-v0: friction must be"):
        run("--policy", save(tmp_path, env_keywords={"friction": -1}))


def test_observations_that_do_not_fit_name_the_keywords(tmp_path, run):
    folder = save(tmp_path, NAMES[1:], env_keywords=SLOW)
    with pytest.raises(UserError) as caught:
        run("--policy", folder, "--env-keywords", '{"friction": 0.9}')
    assert f"{len(NAMES) - 1} observations, 2 actions and the keywords {{" in str(caught.value)
    assert '"speed_ratio": 1.1' in str(caught.value)
    assert "this environment has" in str(caught.value)
    assert "{'friction': 0.9}" in str(caught.value)


@pytest.mark.parametrize("bad", ["{", "[1]", '{"a": 1, "a": 2}', '{"friction": NaN}', '{"friction": 1e999}'])
def test_keywords_that_are_no_json_object_are_one_line(bad):
    with pytest.raises(UserError, match=r"^--env-keywords: .*must be a JSON object"):
        evaluate.parse_keywords(bad)


def test_a_cars_file_is_kept_as_the_car_in_it(tmp_path):
    """So that a run and its policy say what was driven, and the policy's own file may be followed."""
    file = tmp_path / "mine.toml"
    fields = dataclasses.asdict(vehicles["me303"])
    file.write_text("\n".join(f"{name} = {value}" for name, value in fields.items() if isinstance(value, float)))
    keywords = evaluate.parse_keywords(json.dumps({"vehicle": str(file), "friction": 0.5}))
    assert keywords == {"vehicle": dataclasses.asdict(Vehicle.read(file)), "friction": 0.5}
    file.unlink()
    network = trained.load(save(tmp_path / "run", env_keywords=keywords))
    again = trained.keywords_of("x", network, BicycleStabEnv)
    assert gym.make("BicycleStab-v0", **again, speed=30.0).unwrapped.vehicle.mass == vehicles["me303"].mass
    with pytest.raises(UserError, match=r"--env-keywords: vehicle: .*mine\.toml"):
        evaluate.parse_keywords(json.dumps({"vehicle": str(file)}))


def test_a_tires_file_is_kept_as_the_tire_in_it(tmp_path):
    file = tmp_path / "mine.tir"
    file.write_text("FNOMIN = 4000\nPCY1 = 1.4\nPDY1 = 1\nPEY1 = -0.5\nPKY1 = 20\nPKY2 = 2\n")
    with pytest.warns(tires.TireFileWarning):
        keywords = evaluate.parse_keywords(json.dumps({"vehicle": "civic", "tire": str(file)}))
    assert keywords["vehicle"] == dataclasses.asdict(vehicles["civic"].with_tires(file))
    assert keywords["tire"] == {"name": "magic_formula", "shape": 1.4, "curvature": -0.5}
    with pytest.raises(UserError, match=r"^--env-keywords: tire: a property file sets .* give the vehicle, too$"):
        evaluate.parse_keywords(json.dumps({"tire": str(file)}))


# Refused before any work


@pytest.mark.parametrize("env_id", ["CartPole-v1", "Pendulum-v1"])
def test_other_environments_are_refused(run, monkeypatch, env_id):
    monkeypatch.setattr(gym, "make", lambda *_, **__: pytest.fail("made"))
    with pytest.raises(
        UserError, match=r"must be an environment of this package, .*BicycleLaneChange-v0, BicycleStab-v0"
    ):
        run("--env-id", env_id)
    with pytest.raises(UserError, match="of this package"):
        evaluate.make_vector_env(env_id, 2, {})


@pytest.mark.parametrize(
    "env_id", ["", "a b", "nowhere_at_all:X-v0", "BicycleStab-v9", "BicycleStab", "::", "\x1b[31m"]
)
def test_an_unknown_id_is_one_line(env_id):
    with pytest.raises(UserError, match="Ids of this package") as caught:
        evaluate.environment(env_id)
    assert str(caught.value).isprintable()


def test_an_output_that_cannot_be_written_is_refused_first(tmp_path, run, monkeypatch):
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr(gym, "make", lambda *_, **__: pytest.fail("made"))
    for place in (tmp_path, tmp_path / "file" / "x.json", "/dev/null"):
        with pytest.raises(UserError, match=r"^--json: cannot write "):
            run("--json", str(place))
    messages.check_output("--json", None)
    with pytest.raises(UserError, match=r"^--out: cannot write .*file: Not a directory"):
        messages.check_output("--out", tmp_path / "file", folder=True)


@pytest.mark.parametrize(
    ("name", "words", "trusted"),
    [
        ("model.zip", "can hold code, which .* --trust-pickle opens it", "cannot be read as an archive"),
        ("model.pkl", *2 * (r"pickles and \.pt files can hold code",)),
    ],
)
def test_an_archive_is_refused_in_words(tmp_path, run, name, words, trusted):
    (tmp_path / name).write_bytes(b"PK")
    with pytest.raises(UserError, match=words):
        run("--policy", str(tmp_path / name))
    with pytest.raises(UserError, match=trusted):
        run("--policy", str(tmp_path / name), "--trust-pickle")


@pytest.mark.parametrize("algorithm", some_of(["PPO", "SAC", "TD3"], ["PPO"]))
def test_an_archive_that_is_trusted_drives_as_its_model(tmp_path, run, algorithm):
    import stable_baselines3 as sb3
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    env, path = gym.make("BicycleStab-v0"), tmp_path / "model.zip"
    model = getattr(sb3, algorithm)("MlpPolicy", env, seed=3, device="cpu")
    model.save(path)
    observations = np.random.default_rng(0).uniform(-1.0, 1.0, (4, 8)).astype(np.float32)

    def actions():
        policy = evaluate.find_policy(str(path), env, trust_pickle=True)
        return np.array([policy.act(row) for row in observations])

    expected = np.array([model.predict(row, deterministic=True)[0] for row in observations])
    assert np.array_equal(actions(), expected)
    normalizer = VecNormalize(DummyVecEnv([lambda: env]))
    normalizer.obs_rms.mean, normalizer.obs_rms.var = 0.5 * observations[0], np.full(8, 0.25)
    normalizer.save(str(tmp_path / "vecnormalize.pkl"))
    np.testing.assert_allclose(actions()[0], expected[0], atol=1e-6)  # (x - x / 2) / (1 / 2)
    assert not np.allclose(actions()[1], expected[1], atol=1e-6)

    driven, printed = run("--policy", str(path), "lqr", "--trust-pickle")
    assert len(driven) == 2
    assert "was opened: whatever code is in it has run with your rights" in " ".join(printed.split())
    with pytest.raises(UserError, match=r"its actions are Box.*, this environment's Box"):
        evaluate.find_policy(str(path), gym.make("BicycleStab-v0", steer="rear"), trust_pickle=True)


def test_the_policy_of_the_package_by_its_word(tmp_path, run, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pretrained").mkdir()  # the word is no folder
    assert len(run("--policy", "pretrained", "lqr")[0]) == 2
    bicycle_env.register("Mine/Gone-v0", BicycleStabEnv.default_task)
    with pytest.raises(UserError, match=r"env_id with a policy must be one of .*, got 'Mine/Gone-v0'"):
        run("--env-id", "Mine/Gone-v0", "--policy", "pretrained")


MINE = """
import numpy as np
from bicycle_env.control import Policy

def straight(observation):
    assert observation.shape == (8,)
    return np.zeros(2)

class Mine(Policy):
    def __init__(self, plant):
        pass
    def act(self, observation):
        return np.zeros(2, np.float32)
"""


def test_a_function_of_ones_own_drives(tmp_path, run, monkeypatch):
    (tmp_path / "my_functions.py").write_text(MINE)
    monkeypatch.syspath_prepend(tmp_path)
    driven, printed = run("--policy", "my_functions:straight", "my_functions:Mine", "zero")
    assert len(driven) == 3
    assert "my_functions:straight" in printed
    env = gym.make("BicycleStab-v0", telemetry=True)
    mine, zero = control.make("my_functions:straight", env), control.make("zero", env)
    assert mine.name == "my_functions:straight"
    assert mine.act(np.zeros((3, 8), np.float32)).shape == (3, 2)
    assert episodes.evaluate(env, mine, 21, 1) == episodes.evaluate(env, zero, 21, 1)
    with pytest.raises(
        UserError, match=r"must be one of 'straight', 'Mine', 'Policy'|'Policy', 'straight', 'Mine'"
    ) as caught:
        run("--policy", "my_functions:strait")
    assert str(caught.value).endswith("did you mean 'straight'?")


# Shown


def test_brackets_and_escapes_of_a_stranger_are_shown_as_text(tmp_path, run, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hostile = {"note": "[/red]\x1b[2J", "steer": "both"}
    save(tmp_path / "[" / "red]", env_keywords=SLOW, note="[/red]")
    _, printed = run("--policy", "[/red]", "lqr")
    assert "[/red]" in printed
    save(tmp_path / "other", env_keywords=hostile)
    _, printed = run("--policy", "other", "--env-keywords", "{}")
    assert "\x1b" not in printed
    assert "[/red]" in printed


def test_keywords_of_many_cars_say_nothing_about_the_one_that_is_evaluated(tmp_path):
    network = trained.load(save(tmp_path / "run", env_keywords={"dtype": "float32", "threads": 2, "friction": 0.5}))
    assert trained.keywords_of("x", network, BicycleStabEnv) == {"friction": 0.5}


@pytest.mark.parametrize(
    ("algo", "module"), [(None, "train"), ("native-ppo", "ppo"), ("sac", "train --algo sac"), ("jax-ppo", "ppo_jax")]
)
def test_a_training_that_was_stopped_can_go_on(tmp_path, algo, module):
    (tmp_path / "run" / "checkpoint").mkdir(parents=True)
    record = {"env_id": "BicycleStab-v0", "env_keywords": {}, "seed": 0, "settings": {}, "finished": False}
    if algo is not None:
        (tmp_path / "run" / "run.json").write_text(json.dumps({**record, "algo": algo}))
    with pytest.raises(UserError, match=f"was stopped, .*: python -m agents.{module} with the options .* --resume"):
        trained.load(str(tmp_path / "run"))


def test_gymnasiums_words_about_keywords_that_nobody_gave_are_left_out():
    with pytest.raises(UserError) as caught:
        evaluate.make_env("BicycleStab-v0", {"foo": 1, "telemetry": True})
    assert "environment creator" not in str(caught.value)
