"""RL Baselines3 Zoo: train by its command line with --gym-packages, and drive what came out."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ENV_ID, STEPS = "BicycleStab-v0", 2048
SETTINGS = {ENV_ID: {"n_timesteps": STEPS, "policy": "MlpPolicy", "n_envs": 4, "n_steps": 128, "batch_size": 128}}


def zoo(command: str, *words: str) -> None:
    words = ("--algo", "ppo", "--env", ENV_ID, "--gym-packages", "bicycle_env", "-f", *words)
    subprocess.run([sys.executable, "-m", f"rl_zoo3.{command}", *words], check=True, stdout=subprocess.DEVNULL)


def main(folder: Path) -> None:
    settings = folder / "settings.yml"
    settings.write_text(json.dumps(SETTINGS))  # JSON is YAML
    zoo("train", str(folder), "--conf-file", str(settings), "--seed", "1", "--eval-freq", "-1", "--num-threads", "1")
    (run,) = folder.glob(f"ppo/{ENV_ID}_1")
    lengths = [np.loadtxt(file, delimiter=",", skiprows=2, usecols=1, ndmin=1) for file in run.glob("*.monitor.csv")]
    assert len(lengths) == 4
    assert 0 < np.sum(np.concatenate(lengths)) <= STEPS
    print(f"checked: train: {STEPS} steps of PPO in 4 environments, {sum(map(len, lengths))} episodes")
    zoo("enjoy", str(folder), "--exp-id", "1", "--no-render", "-n", "300", "--num-threads", "1")
    print("checked: enjoy: 300 steps of the trained policy")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        main(Path(place))
