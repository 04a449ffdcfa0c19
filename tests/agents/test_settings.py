"""Every registered id has settings for every algorithm, each value with its reason."""

from __future__ import annotations

import pytest

from agents import settings
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
