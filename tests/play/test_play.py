"""bicycle-env play: what it writes and shows, and one line for every mistake."""

import re
import sys
import types

import gymnasium as gym
import numpy as np
import pygame
import pytest

import bicycle_env  # noqa: F401
from bicycle_env import control, play
from bicycle_env.cli import main
from bicycle_env.play import human, window
from bicycle_env.rendering import moving
from bicycle_env.rendering.viewer import HEIGHT, ROAD_HEIGHT, WIDTH

STAB = "BicycleStab-v0"
SHORT = '{"max_episode_steps": 12}'
WORDS = ("--env-id", STAB, "--env-keywords", SHORT)


@pytest.fixture
def events(monkeypatch):
    """What each look at pygame's queue finds, in this order; then nothing more."""
    queue = []
    monkeypatch.setattr(pygame.event, "get", lambda: queue.pop(0) if queue else [])
    return queue


def key(kind, code):
    return pygame.event.Event(kind, key=code)


def test_episodes_are_kept_as_arrays_with_names(tmp_path, capsys):
    file = tmp_path / "run.npz"
    assert main(["play", *WORDS, "--policy", "lqr", "zero", "--starts", "2", "--seed", "5", "--out", str(file)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "start 1 of 2 (seed 5): lqr failed, zero failed",
        "start 2 of 2 (seed 6): lqr failed, zero failed",
        f"written: {file}",
    ]
    with np.load(file) as kept:
        run = dict(kept)
    assert run["policy"].tolist() == ["lqr", "zero", "lqr", "zero"]
    assert run["seed"].tolist() == [5, 5, 6, 6]
    assert run["action_names"].tolist() == ["front_steer", "rear_steer"]
    env = gym.make(STAB, max_episode_steps=12)
    policy = control.make("lqr", env)
    assert tuple(run["state_names"]) == env.unwrapped.state._fields
    assert tuple(run["observation_names"]) == env.unwrapped.observation_names
    observation, _ = env.reset(seed=6)
    for step in range(12):
        assert np.array_equal(run["state"][2, step], env.unwrapped.state)
        assert np.array_equal(run["observation"][2, step], observation)
        action = policy.act(observation)
        assert np.array_equal(run["action"][2, step], action)
        observation, reward, _, _, _ = env.step(action)
        assert run["reward"][2, step] == reward
    assert run["steps"].tolist() == [12] * 4
    assert run["timestep"] == env.unwrapped.action_timestep


def test_what_ends_earlier_is_followed_by_nan(tmp_path):
    file = tmp_path / "run.npz"
    play.play(STAB, ["zero", "lqr"], keywords={"max_episode_steps": 150}, out=file, seed=0, tell=lambda _: None)
    with np.load(file) as run:
        steps, state, outcome = run["steps"], run["state"], run["outcome"]
    assert outcome.tolist()[0] == "left the lane"
    assert steps[0] < steps[1] == 150
    assert np.all(np.isfinite(state[0, : steps[0] + 1]))
    assert np.all(np.isnan(state[0, steps[0] + 1 :]))


def test_several_policies_are_stacked_in_a_picture_that_moves(tmp_path):
    image = pytest.importorskip("PIL.Image")
    file = tmp_path / "run.gif"
    assert main(["play", *WORDS, "--policy", "zero", "lqr", "--out", str(file)]) == 0
    with image.open(file) as picture:
        frames = []
        for k in range(picture.n_frames):
            picture.seek(k)
            frames.append(np.asarray(picture.convert("RGB")).astype(int))
        assert picture.info["duration"] > 1000
    assert len(frames) == 4
    height = round(0.62 * ROAD_HEIGHT) + 20
    assert frames[0].shape == (2 * height + 20, round(0.62 * WIDTH), 3)
    assert np.mean(np.abs(frames[0] - frames[2]).max(axis=-1) > 40) > 0.001
    for top in (0, height, 2 * height):  # a heading each, and the caption
        assert frames[0][top : top + 20].max() > 120


def test_one_policy_is_shown_with_its_instruments(tmp_path, monkeypatch):
    written = []

    def write_frames(path, size, fps, macro_block_size):
        frames = []
        written.append((size, fps, frames))
        try:
            while True:
                frames.append((yield))
        finally:
            with open(path, "wb") as file:
                file.write(b"film")

    module = types.ModuleType("imageio_ffmpeg")
    module.write_frames = write_frames
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", module)
    file = tmp_path / "run.mp4"
    assert main(["play", *WORDS, "--out", str(file), "--starts", "2"]) == 0
    assert file.read_bytes() == b"film"
    ((size, fps, frames),) = written
    assert (size, fps) == ((WIDTH, HEIGHT + 20), 25.0)
    assert len(frames) == 2 * (6 + round(1.5 * 25))
    assert all(side % 2 == 0 for side in size)


def test_a_window_shows_every_start_and_closes(events, monkeypatch, capsys):
    sizes, ticks = [], []
    real = pygame.display.set_mode
    monkeypatch.setattr(pygame.display, "set_mode", lambda size: sizes.append(size) or real(size))
    monkeypatch.setattr(pygame.time, "Clock", lambda: types.SimpleNamespace(tick=ticks.append))
    assert main(["play", *WORDS, "--policy", "zero", "lqr", "--starts", "2"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert sizes == [(WIDTH, 2 * (ROAD_HEIGHT + 20) + 20)]
    assert len(ticks) == 2 * (12 + 2)
    assert set(ticks) == {50}
    assert not pygame.display.get_init()


def test_a_stack_fits_on_a_screen():
    panels = [moving.Panel("", np.zeros((ROAD_HEIGHT, WIDTH, 3), np.uint8), False)] * 7
    assert moving.share_on_screen(panels[:2]) == 1.0
    for count in (3, 7):
        picture = moving.stacked(panels[:count], ("caption",), moving.share_on_screen(panels[:count]))
        assert abs(picture.shape[0] - moving.HIGHEST) < 10


def test_pictures_that_there_is_no_time_for_are_left_out(events, monkeypatch):
    clock = iter(np.arange(0.0, 100.0, 0.0625).tolist())
    monkeypatch.setattr(window, "MOST_BEHIND", 3.0)
    monkeypatch.setattr(window.time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(pygame.time, "Clock", lambda: types.SimpleNamespace(tick=lambda _: None))
    shown = window.Window(48, [])
    drawn = []
    for step in range(50):  # each picture takes three steps
        if not shown.skips():
            shown.show(np.zeros((20, 30, 3), np.uint8))
            drawn.append(step)
    shown.close()
    assert drawn == [*range(0, 50, 3)]


@pytest.mark.parametrize(
    "event", [pygame.event.Event(pygame.QUIT), key(pygame.KEYDOWN, pygame.K_ESCAPE)], ids=["cross", "Esc"]
)
def test_its_user_closes_the_window(events, capsys, event):
    events += [[], [], [event]]
    assert main(["play", *WORDS, "--starts", "5"]) == 0
    assert capsys.readouterr().out == ""
    assert not pygame.display.get_init()


def test_a_human_steers_by_keys(events, tmp_path):
    left, right = pygame.K_LEFT, pygame.K_RIGHT
    events += [[], [key(pygame.KEYDOWN, left)], [], [], [key(pygame.KEYUP, left)], [], [], [key(pygame.KEYDOWN, right)]]
    file = tmp_path / "run.npz"
    assert main(["play", *WORDS, "--policy", "human", "--rear", "lqr", "--out", str(file)]) == 0
    with np.load(file) as run:
        action, observation = run["action"][0], run["observation"][0]
    held, let_go = 0.02 * human.TURN, 0.02 * human.RETURN
    expected = [held, 2 * held, 3 * held, 3 * held - let_go, 0.0, 0.0, -held, -2 * held, -3 * held]
    np.testing.assert_allclose(action[:9, 0], np.float32(expected), atol=1e-6)
    lqr = control.make("lqr", gym.make(STAB))
    assert action[3, 1] == lqr.act(observation[3])[1] != 0.0


def test_a_human_steers_by_a_stick():
    plant = gym.make(STAB).unwrapped
    driver = human.Human(plant, control.REAR_LAWS["sano"](plant))
    observation = np.zeros(8, np.float32)

    def told(value):
        driver.take(pygame.event.Event(pygame.JOYAXISMOTION, axis=0, value=value))
        return driver.act(observation)

    assert told(-0.5)[0] == 0.5
    assert told(-0.5)[1] == driver._rear.act(np.array(0.5), observation) != 0.0
    assert told(0.02)[0] == pytest.approx(0.5 - 0.02 * human.RETURN)
    driver.take(pygame.event.Event(pygame.JOYAXISMOTION, axis=3, value=1.0))
    driver.reset()
    assert driver.act(observation)[0] == 0.0


def test_the_wheel_has_a_lock():
    driver = human.Human(gym.make(STAB).unwrapped, control.make("zero", gym.make(STAB)))
    driver.take(key(pygame.KEYDOWN, pygame.K_d))
    assert [driver.act(np.zeros(8))[0] for _ in range(40)][-1] == -1.0


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--env-id", "BicycleStb-v0"], "--env-id must be one of .*did you mean 'BicycleStab-v0'"),
        (["--env-id", "CartPole-v1"], "--env-id must be of an environment of this package, got 'CartPole-v1'"),
        (["--policy", "lqrr"], "policy must be one of .*did you mean 'lqr'"),
        (["--policy", "sano"], "needs a driver at the front"),
        (["--policy", "tests/data/ppo_stab", "--env-keywords", '{"steer": "rear"}'], "the policy was trained for"),
        (["--level", "hardd"], "level must be one of .*did you mean 'hard'"),
        (["--env-keywords", "{"], "--env-keywords: not JSON"),
        (["--env-keywords", '{"frictio": 1.0}'], "unknown keyword 'frictio'; did you mean 'friction'"),
        (["--out", "run.avi"], "ending of --out must be one of '.gif', '.mp4', '.npz', got '.avi'"),
        (["--out", "/dev/null/run.gif"], "Not a directory"),
        (["--starts", "0"], "--starts must be a whole number in"),
        (["--seed", "-1"], "--seed must be a whole number in"),
        (["--rear", "sano"], "--rear sano is for the policy 'human'"),
        (["--policy", "human", "--rear", "sanoo"], "--rear must be one of .*did you mean 'sano'"),
        (["--policy", "human", "--env-keywords", '{"steer": "rear"}'], "human' steers the front wheels"),
        (["--policy", "human", "--rear", "lqr", "--env-keywords", '{"steer": "front"}'], "front wheels only"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_mistake_is_one_line(capsys, words, complaint):
    assert main(["play", *words]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    assert re.search(complaint, printed.err), printed.err


def test_what_is_missing_is_named_with_its_install_line(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "PIL", None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    for ending, line in (
        ("gif", 'a GIF needs Pillow: pip install -c constraints.txt -e ".[render]"'),
        ("mp4", '.[video]"'),
    ):
        assert main(["play", *WORDS, "--out", str(tmp_path / f"run.{ending}")]) == 2
        assert line in capsys.readouterr().err


@pytest.mark.parametrize("driver", ["nothing_of_that_name", None])
def test_without_a_display_it_says_what_else_there_is(capsys, monkeypatch, driver):
    """Neither a driver that is not there, nor, nothing being asked for, SDL's own for pictures that nobody sees."""
    if driver is None:
        pygame = pytest.importorskip("pygame")
        for name in ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr(pygame.display, "get_driver", lambda: "offscreen")
    else:
        monkeypatch.setenv("SDL_VIDEODRIVER", driver)
    assert main(["play", *WORDS]) == 2
    assert "no window can be opened here" in capsys.readouterr().err
