"""Figures of one's own runs: what is drawn is what was driven, and a bad run is refused in words."""

from __future__ import annotations

import dataclasses
import struct
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from matplotlib.figure import Figure

import bicycle_env
from bicycle_env import control, plots, simulate
from bicycle_env.envs import BicycleStabEnv
from bicycle_env.tasks.marks import Mark
from bicycle_env.tasks.stabilise import Stabilise

SPEED = 43.0


@pytest.fixture(scope="module")
def run():
    return simulate("oversteer", SPEED, (0.01, -0.005), 1.0, initial_state={"lateral_position": 0.5})


def drive(env, name, seed):
    """The states of an episode, and why it ended."""
    plant = env.unwrapped
    policy = control.make(name, plant)
    observation, _ = env.reset(seed=seed)
    states, over = [plant.state], False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        states.append(plant.state)
        over = terminated or truncated
    return states, plant.end


def axes_of(figure, ylabel):
    (found,) = [axes for axes in figure.axes if axes.get_ylabel() == ylabel and axes.get_xlabel() != "sideslip [deg]"]
    return found


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_it_is_found_after_importing_the_package():
    assert bicycle_env.plots.episode is plots.episode
    with pytest.raises(AttributeError, match="no attribute 'plot'"):
        _ = bicycle_env.plot


def test_a_simulated_run_is_drawn_as_it_was_driven(run):
    figure = plots.episode(run)
    assert isinstance(figure, Figure)
    for ylabel, name in (
        ("sideslip [deg]", "sideslip"),
        ("yaw rate [deg/s]", "yaw_rate"),
        ("front steer [deg]", "front_steer"),
        ("rear steer [deg]", "rear_steer"),
    ):
        (line,) = axes_of(figure, ylabel).get_lines()
        np.testing.assert_array_equal(line.get_xdata(), run["time"])
        np.testing.assert_array_equal(line.get_ydata(), np.degrees(run[name]))
    road = axes_of(figure, "lateral position [m]")
    np.testing.assert_array_equal(road.get_lines()[0].get_ydata(), run["lateral_position"])
    assert legend(figure) == ["run 1"]


def test_several_runs_differ_in_colour_and_dashes(run):
    figure = plots.episode(*[run] * 8, labels=list("abcdefgh"), lane=(-1.0, 3.0), duration=0.5)
    assert legend(figure) == [*"abcdefgh", "edge of the lane"]
    lines = axes_of(figure, "sideslip [deg]").get_lines()
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 8
    assert axes_of(figure, "sideslip [deg]").get_xlim() == (0.0, 0.5)


def test_pyplot_is_not_touched(run):
    given = {name: values[::100].tolist() for name, values in run.items()}
    program = f"import sys; from bicycle_env import plots\nplots.png(plots.episode({given}))\n"
    program += "print('matplotlib.pyplot' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_a_run_far_off_does_not_hide_the_road(run):
    off = {**run, "lateral_position": run["lateral_position"] + np.linspace(0.0, 500.0, len(run["time"]))}
    figure = plots.episode(off, lane=(-2.0, 2.0))
    low, high = axes_of(figure, "lateral position [m]").get_ylim()
    assert low < -2.0
    assert 2.0 < high <= 12.0


def test_states_of_an_episode_with_its_environment():
    env = gym.make("BicycleStab-v0")
    driven, ends = zip(*(drive(env, name, 3) for name in ("lqr", "zero")), strict=True)
    figure = plots.episode(*driven, labels=["LQR", "nobody"], env=env, ends=ends)
    assert legend(figure) == ["LQR", "nobody: left the lane at the cross", "steering limit", "edge of the lane"]
    lines = axes_of(figure, "front steer [deg]").get_lines()
    assert [line.get_ydata()[0] for line in lines if line.get_label() == "steering limit"] == [pytest.approx(6.0)]
    assert figure.get_suptitle() == "At 156 km/h = 1.2 x the critical speed"
    sideslip = [state.lateral_velocity / env.unwrapped.speed for state in driven[0]]
    np.testing.assert_allclose(axes_of(figure, "sideslip [deg]").get_lines()[0].get_ydata(), np.degrees(sideslip))
    edges = [line.get_ydata()[0] for line in axes_of(figure, "lateral position [m]").get_lines()[-2:]]
    assert edges == [-1.75, 1.75]


def test_the_lane_change_shows_the_path_that_was_wanted():
    env = gym.make("BicycleLaneChange-v0")
    states, _ = drive(env, "lqr", 4)
    direction, begin = states[0].direction, states[0].change_start
    env.reset(seed=5)  # the environment has gone on to another route
    figure = plots.episode(states, env=env)
    assert "path to follow" in legend(figure)
    path = axes_of(figure, "lateral position [m]").get_lines()[-1]
    x, y = path.get_xdata(), path.get_ydata()
    assert np.all(y[x <= begin] == 0.0)
    assert y[-1] == 3.5 * direction


def test_the_marks_of_a_task_are_drawn():
    @dataclasses.dataclass(frozen=True)
    class Marked(Stabilise):
        def marks(self, task_state, world):
            return Mark("cones", ((5.0, 1.0), (9.0, -1.0))), Mark("ice", ((2.0, 0.0), (4.0, 0.0), (3.0, 1.0)))

    class Env(BicycleStabEnv):
        default_task = Marked()

    env = Env(tire="linear")
    env.reset(seed=0)
    figure = plots.episode([env.state], env=env)
    assert legend(figure) == ["run 1", "edge of the lane", "cones", "ice"]
    road = axes_of(figure, "lateral position [m]")
    (cones,) = [line for line in road.get_lines() if line.get_label() == "cones"]
    assert cones.get_xydata().tolist() == [[5.0, 1.0], [9.0, -1.0]]
    assert road.patches[0].get_xy()[:3].tolist() == [[2.0, 0.0], [4.0, 0.0], [3.0, 1.0]]


@pytest.mark.parametrize(
    ("runs", "keywords", "text"),
    [
        ((), {}, "at least one run"),
        ((3,), {}, r"runs\[0\] must be a mapping"),
        (([],), {}, "without entries"),
        (({"time": [0.0]},), {}, r"runs\[0\] lacks 'longitudinal_position'"),
        (("RUN",), {"labels": ["a", "b"]}, "labels must hold one entry for each of the 1 runs"),
        (("RUN",), {"ends": "spun"}, "ends must hold one entry"),
        (("RUN",), {"duration": -1.0}, "duration must be"),
        (("RUN",), {"lane": 2.0}, "lane must be a pair"),
        (("RUN",), {"lane": (2.0, -2.0)}, r"lane\[1\] must be"),
        (("NO SIDESLIP",), {}, "give env=, or speed="),
        (("NO SIDESLIP",), {"speed": -3.0}, "speed must be"),
        (("SHORT",), {}, "arrays of one length"),
        (("NOT A NUMBER",), {}, r"\['yaw_rate'\] must be finite"),
        (("WORDS",), {}, "must hold arrays of numbers"),
    ],
)
def test_a_bad_run_is_named(run, runs, keywords, text):
    made = {
        "RUN": run,
        "NO SIDESLIP": {name: values for name, values in run.items() if name != "sideslip"},
        "SHORT": {**run, "yaw_rate": run["yaw_rate"][:-1]},
        "NOT A NUMBER": {**run, "yaw_rate": np.full_like(run["yaw_rate"], np.nan)},
        "WORDS": {**run, "yaw_rate": ["fast"] * len(run["time"])},
    }
    with pytest.raises((ValueError, TypeError), match=text):
        plots.episode(*(made.get(given, given) if isinstance(given, str) else given for given in runs), **keywords)


def test_a_picture_is_written_whole(tmp_path):
    plots.save(Figure(figsize=(2, 1)), tmp_path / "new" / "run.png")
    content = (tmp_path / "new" / "run.png").read_bytes()
    assert content.startswith(b"\x89PNG")
    assert struct.unpack(">II", content[16:24]) == (260, 130)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["run.png"]


def test_without_matplotlib_one_line_says_what_to_install(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(
        ModuleNotFoundError, match=r'a figure needs matplotlib: pip install -c constraints\.txt -e "\.\[analysis\]"'
    ):
        plots.episode(run)


def test_another_ending_than_png_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"path must end in \.png.*got .*a\.pdf"):
        plots.save(None, tmp_path / "a.pdf")


def test_the_phase_plane_is_in_degrees(run):
    (phase,) = [axes for axes in plots.episode(run).axes if axes.get_xlabel() == "sideslip [deg]"]
    line = phase.get_lines()[0]
    np.testing.assert_allclose(line.get_xdata(), np.degrees(run["sideslip"]))
    np.testing.assert_allclose(line.get_ydata(), np.degrees(run["yaw_rate"]))
