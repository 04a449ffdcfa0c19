"""Frames and windows, to the pixel."""

import math
import subprocess
import sys
import time

import gymnasium as gym
import numpy as np
import pygame
import pytest

import bicycle_env  # noqa: F401
from bicycle_env.rendering import painting, viewer
from bicycle_env.rendering.dashboard import against_critical, fitted
from bicycle_env.rendering.scene import build_scene
from bicycle_env.rendering.told import drawn_in_words, in_words
from bicycle_env.rendering.viewer import DRAWN_HEIGHT, HEIGHT, ROAD_HEIGHT, RULER_HEIGHT, WIDTH, setup_of
from bicycle_env.tasks.active_steer import ActiveSteer
from bicycle_env.tasks.disturbances import Gust, IcePatch
from bicycle_env.tasks.marks import Mark
from bicycle_env.tasks.options import altered
from bicycle_env.tasks.stabilise import Stabilise

IDS = ("BicycleStab-v0", "BicycleLaneChange-v0")
TURNED = {
    "longitudinal_position": 60.0,
    "lateral_position": 0.6,
    "heading": 0.3,
    "lateral_velocity": -4.0,
    "yaw_rate": 0.7,
    "front_steer": 0.07,
    "rear_steer": -0.04,
}
MIRRORED = {name: value if name == "longitudinal_position" else -value for name, value in TURNED.items()}


@pytest.fixture
def make():
    made = []

    def make(env_id="BicycleStab-v0", render_mode="rgb_array", **keywords):
        made.append(gym.make(env_id, render_mode=render_mode, **keywords))
        return made[-1]

    yield make
    for env in made:
        env.close()


def frame_at(env, state, **options):
    env.reset(seed=0, options={"state": state, **options})
    return env.render()


def road(frame):
    return frame[:ROAD_HEIGHT].astype(int)


def count(image, colour):
    """Pixels of exactly this colour."""
    return int(np.sum(np.all(image == colour, axis=-1)))


# frames


@pytest.mark.parametrize("env_id", IDS)
def test_a_frame_is_an_array_of_its_own(make, env_id):
    env = make(env_id)
    env.reset(seed=0)
    first, second = env.render(), env.render()
    for frame in (first, second):
        assert frame.shape == (HEIGHT, WIDTH, 3)
        assert frame.dtype == np.uint8
        assert frame.flags.c_contiguous
        assert frame.flags.writeable
    assert np.array_equal(first, second)
    assert not np.shares_memory(first, second)
    kept = first.copy()
    env.step(np.ones(2, np.float32))
    assert not np.array_equal(env.render(), kept)
    assert np.array_equal(first, kept)


@pytest.mark.parametrize("name", ["longitudinal_position", "lateral_position", "heading", "front_steer", "rear_steer"])
def test_the_road_shows_every_part_of_the_state(make, name):
    env = make()
    assert np.any(road(frame_at(env, {name: 0.05})) != road(frame_at(env, {name: 0.0})))


@pytest.mark.parametrize("env_id", IDS)
def test_the_road_of_a_mirrored_state_is_flipped(make, env_id):
    env = make(env_id)
    sides = ({"direction": "left"}, {"direction": "right"}) if "Lane" in env_id else ({}, {})
    action = np.array([0.6, -0.9], np.float32)
    images = []
    for state, side, sign in ((TURNED, sides[0], 1.0), (MIRRORED, sides[1], -1.0)):
        frame_at(env, state, **side)
        for _ in range(4):  # a trail, too
            assert not env.step(np.float32(sign) * action)[2]
            image = env.render()
        images.append(road(image))
    difference = np.abs(images[0] - images[1][::-1]).max(axis=-1)
    assert np.mean(difference > 60) < 0.002
    assert np.mean(np.abs(images[0] - images[1]).max(axis=-1) > 60) > 0.02  # it is not symmetrical by itself


def test_left_is_up_and_ahead_is_right(make):
    env = make()
    rows, columns = zip(*(where_car(frame_at(env, {"lateral_position": y})) for y in (-1.0, 1.0)), strict=True)
    scale = ROAD_HEIGHT / (2.0 * (1.75 + 0.9 + math.hypot(2.3, 0.9)))
    assert rows[0] - rows[1] == pytest.approx(2.0 * scale, abs=1.0)
    assert columns[0] == pytest.approx(columns[1], abs=1.0)
    assert columns[0] < 0.4 * WIDTH


def where_car(frame):
    """Mean row and column of the pixels in the body's colour."""
    rows, columns = np.nonzero(np.all(frame[:ROAD_HEIGHT] == painting.CAR, axis=-1))
    return rows.mean(), columns.mean()


def test_metres_are_equally_long_in_both_directions(make):
    image = frame_at(make(), {"longitudinal_position": 60.0})
    rows, columns = np.nonzero(np.all(image[:ROAD_HEIGHT] == painting.CAR, axis=-1))
    assert np.ptp(columns) / np.ptp(rows) == pytest.approx(4.5 / 1.8, rel=0.06)


@pytest.mark.parametrize(("sideslip", "colour"), [(0.3, painting.SATURATED_FORCE), (0.03, painting.FORCE)])
def test_wheels_and_forces_are_painted_and_saturated_axles_change_colour(make, sideslip, colour):
    env = make()
    image = frame_at(env, {"lateral_velocity": sideslip * env.unwrapped.speed})
    base = env.unwrapped
    scene = build_scene(setup_of(base), base.state, base.measure())
    view = painting.View(scene.left, scene.middle, painting.pixels_per_metre(scene, ROAD_HEIGHT), ROAD_HEIGHT)
    for arrow in (scene.front_force, scene.rear_force):
        x, y = view.pixel(tuple(np.mean([arrow.start, arrow.end], axis=0)))
        assert tuple(image[round(y), round(x)]) == colour
    for wheel in scene.wheels.values():
        x, y = view.pixel(tuple(np.mean(wheel, axis=0)))
        assert tuple(image[round(y), round(x)]) in (painting.BLACK, colour)  # an arrow may cover it
    assert count(image[:ROAD_HEIGHT], painting.BLACK) > 100


def test_the_target_lane_is_marked_in_its_own_colour(make):
    env = make("BicycleLaneChange-v0")
    left, right = (frame_at(env, {}, direction=side) for side in ("left", "right"))
    half = ROAD_HEIGHT // 2
    assert count(left[:half], painting.TARGET) > 10_000 > 10 > count(left[half + 4 : ROAD_HEIGHT], painting.TARGET)
    assert count(right[half:ROAD_HEIGHT], painting.TARGET) > 10_000 > 10 > count(right[: half - 4], painting.TARGET)


@pytest.mark.parametrize(
    ("y", "lines"), [(1.5, slice(ROAD_HEIGHT // 2, ROAD_HEIGHT)), (-1.5, slice(0, ROAD_HEIGHT // 2))]
)
@pytest.mark.parametrize("yaw_rate", [1.9, 2.3])
def test_the_end_is_told_in_big_letters_away_from_the_car(make, y, lines, yaw_rate):
    env = make()
    frame_at(env, {"lateral_position": y, "yaw_rate": yaw_rate})
    ended = env.step(np.zeros(2, np.float32))[2]
    assert ended is (yaw_rate > 2.0)
    seen = count(env.render()[lines], painting.VERMILLION)
    assert seen > 5000 if ended else seen < 1000


def test_an_end_in_words_is_not_a_side():
    assert in_words("left_lane") == "left the lane"
    assert in_words("left_road") == "left the road"
    assert in_words("spun") == "spun"


def test_what_was_drawn_is_told_with_its_units():
    task = altered(ActiveSteer(), randomise={"mass": (0.9, 1.1)}, disturbances=(Gust(), IcePatch()))
    own = task.TaskState(*(0.05 for _ in task.TaskState._fields))._replace(
        relative_friction=0.876, mass=1512.3, gust_force=-1000.4, gust_start=1.0, ice_patch_side=-1.0
    )
    told = drawn_in_words(task, own)
    assert told[:4] == ("relative friction 0.88", "amplitude 2.9°", "frequency 0.05 Hz", "dwell 0.05 s")
    assert {"mass 1512 kg", "gust start 1.00 s", "gust force -1000 N", "ice patch side right"} <= set(told)


def test_what_was_drawn_has_a_line_of_its_own(make, monkeypatch):
    env = make()
    line = slice(ROAD_HEIGHT + RULER_HEIGHT, ROAD_HEIGHT + RULER_HEIGHT + DRAWN_HEIGHT)
    assert frame_at(env, {})[line].max() < 100
    monkeypatch.setattr(viewer, "drawn_in_words", lambda *_: ("friction 0.50",))
    assert np.sum(frame_at(env, {})[line, :320].min(axis=-1) > 100) > 50


def test_a_line_that_is_too_long_says_how_much_is_missing():
    parts = ("drawn:", *("a word or two" for _ in range(9)))
    assert fitted(parts, 19, 10_000).count("word") == 9
    short = fitted(parts, 19, 400)
    kept = short.count("word")
    assert 1 < kept < 9
    assert short.startswith("drawn: a word or two, a word")
    assert short.endswith(f", {9 - kept} more")


def test_the_command_is_a_tip_beside_its_gauge(make):
    env = make()
    frame_at(env, {})
    env.step(np.array([-1.0, 0.0], np.float32))
    top = ROAD_HEIGHT + RULER_HEIGHT + DRAWN_HEIGHT
    tips = env.render()[top + 11 : top + 16, 430:580]
    _, columns = np.nonzero(np.all(tips == (236, 236, 232), axis=-1))
    assert 430 + columns.mean() == pytest.approx(504 + 66, abs=2)  # right lock


def test_a_cone_that_was_hit_stays_hit(make, monkeypatch):
    monkeypatch.setattr(Stabilise, "marks", lambda *_: (Mark("cones", ((0.5, 0.0), (0.5, 1.7))),))
    env = make()
    frame_at(env, {})
    for _ in range(10):
        env.step(np.zeros(2, np.float32))
    image = env.render()
    assert env.unwrapped.state.longitudinal_position > 6.0
    assert env.unwrapped._viewer._history[-1].struck == ((0.5, 0.0),)
    frame_at(env, {"longitudinal_position": 8.0})
    assert env.unwrapped._viewer._history[-1].struck == ()
    assert count(image[:ROAD_HEIGHT], painting.STRUCK) > count(env.render()[:ROAD_HEIGHT], painting.STRUCK) + 50


def test_the_speed_is_told_against_the_critical_speed():
    assert against_critical(45.0, 30.0) == "1.50 times critical (30.0 m/s)"
    assert against_critical(45.0, math.inf) == "stable at any speed"


def test_left_steer_is_shown_to_the_left(make):
    env = make()
    rows, middle = slice(ROAD_HEIGHT + RULER_HEIGHT + 36, ROAD_HEIGHT + RULER_HEIGHT + 70), 504

    def blue(front_steer, rear_steer):
        image = frame_at(env, {"front_steer": front_steer, "rear_steer": rear_steer})[rows]
        return count(image[:, 400:middle], painting.SKY_BLUE), count(image[:, middle:600], painting.SKY_BLUE)

    limit = env.unwrapped.front_actuator.angle_limit
    assert blue(0.0, 0.0) == (0, 0)
    whole, nothing = blue(limit, 0.0)
    assert (whole, nothing) == (pytest.approx(66 * 12, abs=24), 0)
    assert blue(-0.5 * limit, 0.0) == (0, pytest.approx(0.5 * whole, abs=24))
    assert blue(0.0, -0.5 * limit) == (0, pytest.approx(whole, abs=24))


def test_the_phase_plane_has_sideslip_to_the_right_and_yaw_rate_upwards(make):
    env = make()

    def point(sideslip, yaw_rate):
        image = frame_at(env, {"lateral_velocity": sideslip * env.unwrapped.speed, "yaw_rate": yaw_rate})
        plane = image[ROAD_HEIGHT + RULER_HEIGHT + 20 : HEIGHT - 40, 725:]
        rows, columns = np.nonzero(np.all(plane == (236, 236, 232), axis=-1))
        return columns.mean(), rows.mean()

    x0, y0 = point(0.0, 0.0)
    x1, y1 = point(0.4, 0.0)
    x2, y2 = point(0.0, 1.0)
    x3, y3 = point(-0.4, -1.0)
    assert x1 > x0 + 20
    assert y1 == pytest.approx(y0, abs=1)
    assert y2 < y0 - 20
    assert x2 == pytest.approx(x0, abs=1)
    assert (x0 - x3, y0 - y3) == pytest.approx((x1 - x0, y2 - y0), abs=1.5)


def test_numbers_far_out_of_range_are_drawn_nevertheless(make):
    env = make()
    state = {"lateral_position": -1e3, "heading": 3.1, "lateral_velocity": 100.0, "yaw_rate": -10.0}
    assert frame_at(env, {**state, "longitudinal_position": -1e5}).shape == (HEIGHT, WIDTH, 3)
    assert frame_at(env, {**state, "longitudinal_position": 1e5}).shape == (HEIGHT, WIDTH, 3)


def test_a_car_without_a_critical_speed_is_drawn(make):
    assert frame_at(make(vehicle="understeer", speed=20.0), {}).shape == (HEIGHT, WIDTH, 3)


def test_frames_are_drawn_after_somebody_has_quit_pygame(make):
    env = make()
    frame_at(env, {})
    pygame.quit()
    assert frame_at(env, TURNED).shape == (HEIGHT, WIDTH, 3)


# the path driven


def test_the_path_driven_is_shown_and_forgotten_at_the_next_start(make):
    env = make()
    fresh = frame_at(env, TURNED)
    for _ in range(5):
        env.step(np.zeros(2, np.float32))
        driven = env.render()
    state = {name: value for name, value in env.unwrapped.state._asdict().items() if name in TURNED}
    moved = frame_at(env, state)
    assert np.any(road(moved) != road(driven))
    assert np.array_equal(frame_at(env, TURNED), fresh)


def test_the_path_driven_is_forgotten_even_if_the_next_start_is_not_drawn(make):
    def late(env):
        env.reset(seed=0)
        for _ in range(8):
            env.step(np.zeros(2, np.float32))
        return env.render()

    expected = late(make())
    env = make()
    frame_at(env, {"lateral_position": 0.5})
    assert np.array_equal(late(env), expected)


def test_the_path_driven_ends_where_a_snapshot_was_taken(make):
    env = make()
    fresh = frame_at(env, TURNED)
    start = env.unwrapped.snapshot()
    for _ in range(5):
        env.step(np.zeros(2, np.float32))
        env.render()
    env.unwrapped.restore(start)
    assert np.array_equal(env.render(), fresh)


# windows


def test_frames_need_no_display(make):
    pygame.display.quit()
    frame_at(make(), TURNED)
    assert not pygame.display.get_init()


def test_a_window_shows_what_the_frame_shows(make):
    expected = frame_at(make(), TURNED)
    assert frame_at(make(render_mode="human"), TURNED) is None
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
    assert np.array_equal(shown, expected)


def test_a_window_can_be_closed_twice_and_opened_again(make):
    env = make(render_mode="human")
    env.reset(seed=0)
    assert pygame.display.get_surface() is not None
    viewer = env.unwrapped._viewer
    env.close()
    assert not pygame.display.get_init()
    env.close()
    viewer.close()
    make(render_mode="human").reset(seed=0)  # another environment's: this one is closed for good
    assert pygame.display.get_surface() is not None


def test_a_window_that_its_user_closes_stays_closed_and_the_episode_goes_on(make):
    env = make(render_mode="human")
    env.reset(seed=0)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    env.step(np.zeros(2, np.float32))
    assert not pygame.display.get_init()
    env.step(np.zeros(2, np.float32))
    env.reset(seed=1)
    env.step(np.zeros(2, np.float32))
    assert not pygame.display.get_init()


def test_closing_one_environment_leaves_another_drawable(make):
    first, second = make(render_mode="human"), make(render_mode="human")
    first.reset(seed=0)
    second.reset(seed=0)
    viewer = first.unwrapped._viewer
    first.close()
    second.step(np.zeros(2, np.float32))
    viewer.close()
    assert pygame.display.get_surface() is not None


def test_a_window_keeps_real_time(make):
    env = make(render_mode="human", control_timestep=0.06)
    env.reset(seed=0)
    begin = time.perf_counter()
    for _ in range(5):
        env.step(np.zeros(2, np.float32))
    assert time.perf_counter() - begin > 0.8 * 5 * 0.06


# the extra


def test_without_pygame_the_error_names_what_to_install(make, monkeypatch):
    env = make()
    env.reset(seed=0)
    for name in [name for name in sys.modules if name.startswith("bicycle_env.rendering.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(gym.error.DependencyNotInstalled, match=r'pip install -c constraints\.txt -e "\.\[render\]"'):
        env.render()


def test_pygame_is_not_loaded_before_the_first_picture():
    code = (
        "import sys, gymnasium, bicycle_env\n"
        "env = gymnasium.make('BicycleStab-v0', render_mode='rgb_array'); env.reset(seed=0)\n"
        "assert 'pygame' not in sys.modules\n"
        "env.render()\n"
        "assert 'pygame' in sys.modules and 'matplotlib' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
