"""A corridor that changes along the road: drawn from border to border of the picture, a step as a step."""

import dataclasses
import importlib
import itertools
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import bicycle_env  # noqa: F401
from bicycle_env import plots
from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.rendering import painting
from bicycle_env.rendering import scene as geometry
from bicycle_env.rendering.corridor import corridor
from bicycle_env.rendering.scene import build_scene, side_wind
from bicycle_env.rendering.viewer import setup_of
from bicycle_env.tasks.checking import check
from bicycle_env.tasks.disturbances import Gust, IcePatch
from bicycle_env.tasks.episode import Reference
from bicycle_env.tasks.marks import Mark
from bicycle_env.tasks.options import altered
from bicycle_env.tasks.stabilise import Stabilise

EXAMPLES = Path(__file__).parents[2] / "examples"
GATES = ((15.0, 27.0, 0.0), (40.5, 51.5, 3.5), (64.0, 76.0, 0.0))
"""From, to, middle, m: each 2 m wide; elsewhere the road is from -4 m to 7 m."""


@dataclasses.dataclass(frozen=True)
class Gates(Stabilise):
    """Between rows of cones; `side`: -1 for the mirror image."""

    side: float = 1.0

    def reference(self, xp):
        side = self.side

        def reference(state, task_state, world):
            x, zero = state.longitudinal_position, 0.0 * state.longitudinal_position
            centre, half = zero + 1.5, zero + 5.5
            for begin, end, middle in GATES:
                inside = (x >= begin) & (x <= end)
                centre, half = xp.where(inside, middle, centre), xp.where(inside, 1.0, half)
            return Reference(side * centre, zero, side * centre, side * centre, half)

        return reference

    def marks(self, task_state, world):
        cones = [(x, self.side * (y + s)) for begin, end, y in GATES for x in (begin, end) for s in (-1.0, 1.0)]
        return Mark("cones", cones), Mark("ice", [(18.0, 0.0), (24.0, 0.0), (24.0, self.side), (18.0, self.side)])


def gusty(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    task = importlib.import_module("my_task").Gusty()
    sys.modules.pop("my_task")  # another test imports it to register it
    gym.registry.pop("Mine/Gusty-v0")
    return task


@pytest.fixture(scope="module")
def stab():
    return gym.make("BicycleStab-v0").unwrapped


def scene_of(env, task, place, side=1.0):
    """Of a car at a place on another task's road."""
    env.reset(seed=0, options={"state": {"longitudinal_position": place, "lateral_position": 0.3 * side}})
    state = task.State(*env.state, *(0.0 for _ in task.TaskState._fields))
    setup = setup_of(env)._replace(task=task)
    car, own = CarState(*state[: len(CarState._fields)]), task.TaskState(*state[len(env.state) :])
    here = task.reference(PYTHON)(car, own, setup.world)
    return build_scene(setup, state, {**env.measure(), **{f"reference_{k}": v for k, v in here._asdict().items()}})


PLACES = (0.0, 14.9, 20.0, 35.0, 48.0, 58.0, 75.0, 95.0)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("which", ["gates", "gusty"])
def test_all_of_the_road_that_is_in_sight_is_in_the_picture(stab, monkeypatch, which, place):
    task = Gates() if which == "gates" else gusty(monkeypatch)
    scene = scene_of(stab, task, place)
    outline = np.array(scene.corridor)
    assert outline[:, 0].min() <= scene.left
    assert outline[:, 0].max() >= scene.right
    assert abs(outline[:, 1] - scene.middle).max() < scene.half_height - 0.5 * stab.vehicle.body_width
    for line in scene.road_edges:
        along = np.array(line)[:, 0]
        assert along.min() <= scene.left + 0.2
        assert along.max() >= scene.right - 0.2


@pytest.mark.parametrize("place", PLACES)
def test_no_lanes_where_the_task_has_none(stab, place):
    scene = scene_of(stab, Gates(), place)
    assert scene.target_lane == ()
    assert scene.lane_dashes == ()


def test_a_step_looks_like_a_step(stab):
    scene = scene_of(stab, Gates(), 20.0)
    right_edge = scene.corridor[: len(scene.corridor) // 2]
    steps = [(one[0], other[0]) for one, other in itertools.pairwise(right_edge) if abs(other[1] - one[1]) > 0.5]
    assert len(steps) == 4
    for (begin, end), at in zip(steps, (15.0, 27.0, 40.5, 51.5), strict=True):
        assert begin - 1e-9 <= at <= end + 1e-9
        assert end - begin < 0.01
    # the white line stands across the road there
    for line in scene.road_edges:
        points = np.array(line)
        near = points[abs(points[:, 0] - 27.0) < 0.5]
        assert np.ptp(near[:, 0]) == pytest.approx(geometry.LINE_WIDTH, abs=0.01)
        assert np.ptp(near[:, 1]) > 2.0


def test_posts_stand_beside_the_road(stab):
    scene = scene_of(stab, Gates(), 20.0)
    beside = {
        post[0][0]: sorted({y for part in scene.posts if part[0][0] == post[0][0] for _, y in part})
        for post in scene.posts
    }
    near, far = geometry.POST
    assert beside[20.0] == pytest.approx([-1.0 - far, -1.0 - near, 1.0 + near, 1.0 + far])
    assert beside[30.0] == pytest.approx([-4.0 - far, -4.0 - near, 7.0 + near, 7.0 + far])


def test_the_mirror_image_is_exact(stab):
    one, other = scene_of(stab, Gates(), 35.0), scene_of(stab, Gates(side=-1.0), 35.0, -1.0)
    assert (one.left, one.right, one.half_height, one.middle) == (
        other.left,
        other.right,
        other.half_height,
        -other.middle,
    )
    for name in ("road_edges", "posts", "path_dashes", "ice"):
        mine = sorted(sorted(shape) for shape in getattr(one, name))
        theirs = sorted(sorted((x, -y) for x, y in shape) for shape in getattr(other, name))
        assert mine == theirs
    assert sorted(one.cones) == sorted((x, -y) for x, y in other.cones)
    assert sorted(one.corridor) == sorted((x, -y) for x, y in other.corridor)


def test_a_road_that_widens_for_ever_ends_the_widening(stab):
    @dataclasses.dataclass(frozen=True)
    class Funnel(Stabilise):
        def reference(self, xp):
            def reference(state, task_state, world):
                zero = 0.0 * state.longitudinal_position
                return Reference(zero, zero, zero, zero, 2.0 + abs(state.longitudinal_position))

            return reference

    scene = scene_of(stab, Funnel(), 10.0)
    assert np.array(scene.corridor)[:, 0].max() >= scene.right
    assert scene.half_height < 1e6


def of(law):
    """The corridor of half widths by place, to both sides of 0."""
    return lambda places: Reference(0.0, 0.0, 0.0, 0.0 * places, law(places))


def test_a_straight_corridor_is_two_points():
    found = corridor(of(lambda x: 1.75), -3.3, 12.2)
    assert found.is_straight
    assert found.places.tolist() == pytest.approx([-3.3, 12.2])
    assert found.outline == (
        (found.places[0], -1.75),
        (found.places[1], -1.75),
        (found.places[1], 1.75),
        (found.places[0], 1.75),
    )


def test_a_slope_is_followed():
    found = corridor(of(lambda x: 3.0 + np.sin(x)), 0.0, 20.0)
    assert not found.is_straight
    dense = np.linspace(0.0, 20.0, 5000)
    assert abs(np.interp(dense, found.places, found.left) - 3.0 - np.sin(dense)).max() < 0.002


def test_a_line_is_as_wide_everywhere():
    """Also across the road, at a step, and where it is steep."""
    found = corridor(of(lambda x: np.where(x < 5.03, 2.0, 3.5)), 0.0, 10.0)
    (_, line) = (np.array(shape) for shape in found.lines(0.2))
    half = len(line) // 2
    outer, inner = line[:half], line[half:][::-1]
    middle = np.column_stack([found.places, found.left])
    np.testing.assert_allclose(0.5 * (outer + inner), middle, atol=1e-12)
    step = np.argmax(np.diff(found.left))
    corner = np.hypot(*(outer - inner)[step])
    assert corner == pytest.approx(0.2 * np.sqrt(2.0), rel=0.01)  # a right angle
    assert outer[0] - inner[0] == pytest.approx([0.0, 0.2])


def test_cones_and_ice_are_painted_where_they_are(stab):
    scene = scene_of(stab, Gates(), 30.0)
    size = (960, 308)
    image = painting.pygame.surfarray.array3d(painting.paint_road(scene, *size))
    view = painting.View(scene.left, scene.middle, size[1] / (2.0 * scene.half_height), size[1])
    for point, colour in (((27.0, -1.0), painting.CONE), ((40.5, 4.5), painting.CONE), ((21.0, 0.4), painting.ICE)):
        x, y = (round(value) for value in view.pixel(point))
        assert tuple(image[x, y]) == colour, point
    assert tuple(image[tuple(round(value) for value in view.pixel((21.0, -0.6)))]) == painting.ASPHALT


def test_cones_under_the_body_are_hit(stab):
    corner = (27.0, -1.0)
    stab.reset(seed=0, options={"state": {"longitudinal_position": 26.0, "lateral_position": -0.3}})
    state, setup, measured = stab.state, setup_of(stab)._replace(task=Gates()), stab.measure()
    scene = build_scene(setup, state, measured)
    assert scene.struck == (corner,)
    assert len(scene.cones) == 11
    beside = build_scene(setup, state._replace(lateral_position=-0.05), measured)
    assert (beside.struck, len(beside.cones)) == ((), 12)
    assert build_scene(setup, state, measured, struck=[(76.0, 1.0)]).struck == (corner, (76.0, 1.0))
    size = (960, 308)
    image = painting.pygame.surfarray.array3d(painting.paint_road(scene, *size))
    view = painting.View(scene.left, scene.middle, size[1] / (2.0 * scene.half_height), size[1])
    assert tuple(image[tuple(round(value) for value in view.pixel(corner))]) == painting.STRUCK


@pytest.mark.parametrize(("y", "side", "count"), [(0.05, 0.0, 0), (0.2, 1.0, 2), (-0.2, -1.0, 2)])
def test_corners_that_are_outside_are_marked(stab, y, side, count):
    """Of a body that is 1.8 m wide, between edges at 1 m."""
    stab.reset(seed=0, options={"state": {"longitudinal_position": 20.0, "lateral_position": y}})
    scene = build_scene(setup_of(stab)._replace(task=Gates()), stab.state, stab.measure())
    assert [np.sign(across - y) for _, across in scene.outside] == [side] * count


def test_an_obstacle_is_painted_where_it_is(stab):
    @dataclasses.dataclass(frozen=True)
    class Blocked(Stabilise):
        def marks(self, task_state, world):
            return (Mark("obstacle", ((10.0, 0.0), (14.0, 0.0), (14.0, 1.5), (10.0, 1.5))),)

    scene = scene_of(stab, Blocked(), 4.0)
    size = (960, 308)
    image = painting.pygame.surfarray.array3d(painting.paint_road(scene, *size))
    view = painting.View(scene.left, scene.middle, size[1] / (2.0 * scene.half_height), size[1])
    assert tuple(image[tuple(round(value) for value in view.pixel((12.0, 0.8)))]) == painting.OBSTACLE


@pytest.mark.parametrize(("time", "blows"), [(0.5, False), (1.1, True), (1.6, False)])
@pytest.mark.parametrize("force", [2000.0, -2000.0])
def test_a_gust_pushes_the_side_of_the_body(stab, time, blows, force):
    task = altered(Stabilise(), disturbances=(Gust(start=1.0, duration=0.5, arm=0.4),))
    stab.reset(seed=0, options={"state": {"longitudinal_position": 20.0}})
    setup = setup_of(stab)
    setup = setup._replace(task=task, world=setup.world._replace(settings=task.settings(stab.speed)))
    state = task.State(*stab.state, gust_start=1.0, gust_force=force)._replace(time=time)
    scene = build_scene(setup, state, stab.measure())
    assert side_wind(setup, state) == (force * blows, pytest.approx(0.4 * force * blows))
    if not blows:
        assert scene.gust.start == scene.gust.end
        return
    (x0, y0), (x1, y1) = scene.gust.start, scene.gust.end
    assert (x0, x1) == (pytest.approx(20.4), pytest.approx(20.4))
    assert y1 == pytest.approx(-0.5 * stab.vehicle.body_width * np.sign(force))
    assert y1 - y0 == pytest.approx(force * geometry.GUST_ARROW)


def test_on_an_area_marks_show_that_the_car_moves(stab):
    @dataclasses.dataclass(frozen=True)
    class Wide(Stabilise):
        def reference(self, xp):
            def reference(state, task_state, world):
                zero = 0.0 * state.longitudinal_position
                return Reference(zero, zero, zero, zero, 100.0)

            return reference

    here, there = (scene_of(stab, Wide(), place).tufts for place in (10.0, 13.0))
    assert scene_of(stab, Stabilise(), 10.0).tufts == ()
    assert len(set(here) & set(there)) > 10
    assert here != there


@pytest.mark.parametrize("edge", [0.0, None])
@pytest.mark.exhaustive
def test_an_ice_patch_is_drawn_where_it_acts(edge):
    patch = IcePatch(begin=(20.0, 22.0), length=8.0, side="right", edge=edge)
    env = gym.make("BicycleStab-v0", disturbances=(Gust(), patch), render_mode="rgb_array", telemetry=True)
    env.reset(seed=3, options={"state": {"longitudinal_position": 24.0, "lateral_position": -0.5}})
    plant = env.unwrapped
    begin = plant.state.ice_patch_begin
    scene = build_scene(setup_of(plant), plant.state, plant.measure())
    ((shape,), cones) = (scene.ice, scene.cones)
    assert sorted({x for x, _ in shape}) == [begin, begin + 8.0]
    assert max(y for _, y in shape) == (0.0 if edge == 0.0 else 100.0)
    assert cones == ()
    size = (960, 308)
    image = painting.pygame.surfarray.array3d(painting.paint_road(scene, *size))
    view = painting.View(scene.left, scene.middle, size[1] / (2.0 * scene.half_height), size[1])

    def colour(x, y):
        return tuple(image[tuple(round(value) for value in view.pixel((x, y)))])

    assert colour(begin + 7.5, -1.2) == painting.ICE
    assert colour(begin + 7.5, 1.2) == (painting.ASPHALT if edge == 0.0 else painting.ICE)
    assert colour(begin + 7.5, -3.0) != painting.ICE  # beside the road
    assert plots.episode([plant.state], env=env).axes[0].patches


def test_what_is_added_to_a_task_leaves_its_marks(stab):
    task = altered(Gates(), randomise={"friction": (0.5, 1.0)}, action_delay=1)
    assert scene_of(stab, task, 20.0).cones == scene_of(stab, Gates(), 20.0).cones


@pytest.mark.parametrize(
    ("marks", "words"),
    [
        ([("cone", [(0.0, 0.0)])], "kind must be one of 'cones', 'ice', 'obstacle', got 'cone'; did you mean 'cones'"),
        ([("cones", [(0.0, np.nan)])], "y must be a finite number, got nan"),
        ([("ice", [(0.0, 0.0), (1.0, 0.0)])], "number of points of ice must be a whole number in .3, .*got 2"),
        ([("cones", [0.0, 1.0])], "TypeError: cannot unpack"),
        (None, "TypeError: 'NoneType' object is not iterable"),
    ],
)
def test_marks_that_are_none_are_refused_with_the_task(marks, words):
    task = dataclasses.dataclass(frozen=True)(type("Marked", (Stabilise,), {"marks": lambda *_: marks}))()
    with pytest.raises(ValueError, match=f"^task Marked: its marks fail .*{words}"):
        check(task)
