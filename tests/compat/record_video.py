"""Gymnasium's RecordVideo: an episode of one car, and of one of many, as films that are read again frame by frame."""

import tempfile
from pathlib import Path

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import RecordVideo, vector
from moviepy import VideoFileClip

import bicycle_env  # noqa: F401


def main(folder: Path) -> None:
    env = RecordVideo(gym.make("BicycleStab-v0", render_mode="rgb_array"), str(folder), disable_logger=True)
    env.reset(seed=0)
    steps, over = 0, False
    while not over:
        _, _, terminated, truncated, _ = env.step(np.zeros(2, np.float32))
        steps, over = steps + 1, terminated or truncated
    shape = env.unwrapped.render().shape
    env.close()
    (file,) = folder.glob("*.mp4")
    with VideoFileClip(str(file)) as film:
        frames = list(film.iter_frames())
    assert abs(len(frames) - (steps + 1)) <= 1, (len(frames), steps)
    assert frames[0].shape == shape
    assert np.mean(np.abs(frames[0].astype(float) - frames[-1])) > 1.0, "the picture moves"
    print(f"checked: RecordVideo wrote {len(frames)} frames of {shape[1]} x {shape[0]} for an episode of {steps} steps")

    envs = gym.make_vec("BicycleStab-v0", 4, render_mode="rgb_array")
    films = vector.RecordVideo(envs, str(folder / "many"), record_first_only=True, episode_trigger=lambda k: k == 0)
    films.reset(seed=0)
    for _ in range(20):
        films.step(np.zeros((4, 2), np.float32))
    films.close()
    (file,) = (folder / "many").glob("*.mp4")
    with VideoFileClip(str(file)) as film:
        row = list(film.iter_frames())
    assert abs(len(row) - 21) <= 1, len(row)
    assert np.array_equal(row[0].shape, shape)
    print(f"checked: of many cars, {len(row)} frames")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        main(Path(place))
