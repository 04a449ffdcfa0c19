"""Every registered id has settings for every algorithm, each value with its reason."""

from __future__ import annotations

import dataclasses
import tomllib

import pytest
import tyro

from agents import policy_search, ppo, ppo_jax, settings
from agents.messages import UserError
from bicycle_env.registration import ENVIRONMENTS

IDS = [row.id for row in ENVIRONMENTS]


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("algo", settings.ALGORITHMS)
def test_settings_are_shipped(env_id, algo):
    chosen = settings.read(env_id, algo)
    assert chosen.total_timesteps > 0
    assert chosen.n_envs > 0
    assert "learning_rate" in chosen.model
    assert "net_arch" in chosen.network


@pytest.mark.parametrize("env_id", IDS)
def test_every_value_has_its_reason(env_id):
    for line in (settings.CONFIGS / f"{env_id}.toml").read_text().splitlines():
        if "=" in line.partition("#")[0]:
            assert len(line.partition("#")[2].strip()) > 5, line


def test_a_bad_file_is_one_line(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text("[ppo]\ntotal_timesteps = ")
    with pytest.raises(UserError, match="not a settings file"):
        settings.read("BicycleStab-v0", "ppo", path)
    path.write_text("[ppo]\nn_envs = 1\n")
    with pytest.raises(UserError, match="total_timesteps"):
        settings.read("BicycleStab-v0", "ppo", path)
    with pytest.raises(UserError, match="no settings file"):
        settings.read("BicycleStab-v0", "ppo", tmp_path / "nowhere.toml")


def test_a_task_of_ones_own_has_the_default_settings_and_a_remark(capsys):
    assert settings.read("Mine/Nothing-v0", "ppo") == settings.read("BicycleStab-v0", "ppo")
    assert "no settings are shipped for Mine/Nothing-v0" in capsys.readouterr().err


# Of this package's own trainers

OWN = {trainer.ALGORITHM: trainer.Args for trainer in (ppo, policy_search, ppo_jax)}


def test_every_trainer_s_settings_are_its_options():
    assert set(OWN) == set(settings.OWN)
    for algo, options in OWN.items():
        others = {"env_id", "env_keywords", "seed", "seeds", "out", "resume", "quiet"}
        assert set(settings.OWN[algo]) == {field.name for field in dataclasses.fields(options)} - others
        settings.own(options(), algo)


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("algo", OWN)
def test_what_is_shipped_for_the_id_and_the_level(env_id, algo):
    shipped = tomllib.loads((settings.CONFIGS / f"{env_id}.toml").read_text()).get(algo, {})
    levels = {name: value for name, value in shipped.items() if isinstance(value, dict)}
    plain = {name: value for name, value in shipped.items() if name not in levels}
    for level, more in {"no such level": {}, **levels}.items():
        words = ["--env-id", env_id, "--env-keywords", f'{{"level": "{level}"}}']
        found = settings.own(settings.usual(OWN[algo], algo, words), algo)
        assert found == {**settings.own(OWN[algo](), algo), **plain, **more}


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.setattr(settings, "CONFIGS", tmp_path)
    table = "[native-ppo]\ncars = 7\nhold = 2\ngamma = [0.5, 0.6]\n[native-ppo.hard]\nhold = 3\n[ppo]\nx = 1\n"
    (tmp_path / "Mine-v0.toml").write_text(table)
    return tmp_path / "Mine-v0.toml"


HARD = '{"level": "hard"}'


@pytest.mark.usefixtures("mine")
@pytest.mark.parametrize(
    ("words", "changes"),
    [
        (["--env-id", "Mine-v0"], {"cars": 7, "hold": 2, "gamma": (0.5, 0.6)}),
        (["--cars", "9", "--env-id=Mine-v0", "--no-mirrored"], {"cars": 7, "hold": 2, "gamma": (0.5, 0.6)}),
        (["--env_id", "Mine-v0", "--env_keywords", HARD], {"cars": 7, "hold": 3, "gamma": (0.5, 0.6)}),
        (["--env-keywords", HARD, "--env-id", "Mine-v0"], {"cars": 7, "hold": 3, "gamma": (0.5, 0.6)}),
        (["--env-id", "Mine-v0", "--env-keywords", "{"], {"cars": 7, "hold": 2, "gamma": (0.5, 0.6)}),
        (["--env-id", "Mine-v0", "--env-keywords", '{"level": [1]}'], {"cars": 7, "hold": 2, "gamma": (0.5, 0.6)}),
        (["--env-id", "Other-v0"], {}),
        ([], {}),
    ],
    ids=str,
)
def test_the_command_line_says_whose_settings(words, changes):
    assert settings.usual(ppo.Args, ppo.ALGORITHM, words) == ppo.Args(**changes)


@pytest.mark.usefixtures("mine")
def test_what_is_given_on_the_command_line_has_its_way():
    words = ["--env-id", "Mine-v0", "--env-keywords", HARD, "--hold", "5"]
    args = tyro.cli(ppo.Args, default=settings.usual(ppo.Args, ppo.ALGORITHM, words), args=words)
    assert (args.env_id, args.cars, args.hold, args.gamma) == ("Mine-v0", 7, 5, (0.5, 0.6))


@pytest.mark.parametrize(("line", "text"), [("cars = 1", "cars must be a whole number"), ("carz = 9", "cars")])
def test_a_file_with_a_mistake_is_named(mine, line, text):
    mine.write_text(f"[native-ppo]\n{line}\n")
    with pytest.raises((ValueError, TypeError), match=f"{mine}.*{text}"):
        settings.usual(ppo.Args, ppo.ALGORITHM, ["--env-id", "Mine-v0"])


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"decisions": 0}, r"^--decisions must be a whole number in \[1, 100000\], got 0$"),
        ({"hold": 1001}, "^--hold must be"),
        ({"history": 0}, "^--history must be"),
        ({"minibatch": 0}, "^--minibatch must be"),
        ({"gamma": (0.9, -0.1)}, r"^--gamma\[1\] must be"),
        ({"gae_lambda": 1.1}, "^--gae-lambda must be"),
        ({"clip": 0.0}, "^--clip must be"),
        ({"entropy": -1.0}, "^--entropy must be"),
        ({"reward_scale": float("inf")}, "^--reward-scale must be"),
        ({"width": 5000}, "^--width must be"),
        ({"seed": -1}, "^--seed must be at least 0"),
    ],
    ids=str,
)
def test_a_value_out_of_range_is_one_line_that_names_the_option(change, text):
    with pytest.raises(UserError, match=text) as caught:
        settings.own(ppo.Args(**change), ppo.ALGORITHM)
    assert "\n" not in str(caught.value)
