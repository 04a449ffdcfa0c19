"""The geometry of the pictures, in m on the road."""

import math

import gymnasium as gym
import numpy as np
import pytest

import bicycle_env  # noqa: F401
from bicycle_env.rendering import scene as geometry
from bicycle_env.rendering.scene import Arrow, arrow_outline, build_scene
from bicycle_env.rendering.viewer import setup_of

IDS = ("BicycleStab-v0", "BicycleLaneChange-v0")
TURNED = {
    "longitudinal_position": 37.0,
    "lateral_position": 0.6,
    "heading": 0.3,
    "lateral_velocity": -4.0,
    "yaw_rate": 0.7,
    "front_steer": 0.07,
    "rear_steer": -0.04,
}


def env_at(env_id, state=None, duration=None, **options):
    env = gym.make(env_id, **({} if duration is None else {"duration": duration})).unwrapped
    env.reset(seed=0, options={"state": state or {}, **options})
    return env


def scene_of(env, trail=(), **measured):
    return build_scene(setup_of(env), env.state, {**env.measure(), **measured}, trail)


def into_body(env, shape):
    """Points of the road as (forward, to the left) of the centre of mass."""
    state = env.state
    points = np.array(shape) - (state.longitudinal_position, state.lateral_position)
    c, s = math.cos(state.heading), math.sin(state.heading)
    return points @ np.array([[c, -s], [s, c]])


def test_the_car_is_to_scale():
    env = env_at("BicycleStab-v0", TURNED)
    body, vehicle = into_body(env, scene_of(env).body), env.vehicle
    assert np.max(body, axis=0) == pytest.approx([vehicle.front_extent, 0.5 * vehicle.body_width])
    assert np.min(body, axis=0) == pytest.approx([-vehicle.rear_extent, -0.5 * vehicle.body_width])


def test_the_windscreen_shows_where_the_front_is():
    env = env_at("BicycleStab-v0", TURNED)
    scene = scene_of(env)
    assert np.min(into_body(env, scene.windscreen)[:, 0]) > 0.0
    assert np.max(into_body(env, scene.rear_window)[:, 0]) < 0.0
    assert (
        np.min(into_body(env, scene.headlights[0]), axis=0)[1] > 0.0 > np.max(into_body(env, scene.headlights[1])[:, 1])
    )


@pytest.mark.parametrize("steer", [(0.0, 0.0), (0.1, 0.0), (0.0, -0.05), (-0.08, 0.03)])
def test_wheels_are_turned_by_the_steer_angle(steer):
    env = env_at("BicycleStab-v0", {**TURNED, "front_steer": steer[0], "rear_steer": steer[1]})
    for name, wheel in scene_of(env).wheels.items():
        corners = into_body(env, wheel)
        along = corners[1] - corners[0]
        assert math.atan2(along[1], along[0]) == pytest.approx(steer["rear" in name], abs=1e-12)
        assert np.hypot(*along) == pytest.approx(geometry.TIRE_LENGTH)


def test_wheels_are_where_the_vehicle_has_them():
    env = env_at("BicycleStab-v0", TURNED)
    wheels, vehicle = scene_of(env).wheels, env.vehicle
    places = {name: np.mean(into_body(env, wheel), axis=0) for name, wheel in wheels.items()}
    assert places["front_left"] == pytest.approx([vehicle.cg_to_front, vehicle.front_half_track])
    assert places["front_right"] == pytest.approx([vehicle.cg_to_front, -vehicle.front_half_track])
    assert places["rear_left"] == pytest.approx([-vehicle.cg_to_rear, vehicle.rear_half_track])
    assert places["rear_right"] == pytest.approx([-vehicle.cg_to_rear, -vehicle.rear_half_track])


@pytest.mark.parametrize("part", [-1.0, -0.5, 0.3, 1.0])
def test_force_arrows_have_the_sign_and_the_size_of_the_force(part):
    env = env_at("BicycleStab-v0", TURNED)
    setup, vehicle = setup_of(env), env.vehicle
    assert setup.front_grip == env.friction * vehicle.front_axle_load
    forces = {"front_lateral_force": part * setup.front_grip, "rear_lateral_force": -part * setup.rear_grip}
    scene = scene_of(env, **forces)
    length = part * geometry.GRIP_ARROW
    for arrow, along, steer, to_left in (
        (scene.front_force, vehicle.cg_to_front, env.state.front_steer, length),
        (scene.rear_force, -vehicle.cg_to_rear, env.state.rear_steer, -length),
    ):
        start, end = into_body(env, (arrow.start, arrow.end))
        assert start == pytest.approx([along, 0.0], abs=1e-12)
        assert end - start == pytest.approx([-math.sin(steer) * to_left, math.cos(steer) * to_left], abs=1e-12)


def test_arrows_of_forces_beyond_friction_end_somewhere():
    env = env_at("BicycleStab-v0")
    grip = setup_of(env).front_grip
    scene = scene_of(env, front_lateral_force=7.0 * grip, rear_lateral_force=-7.0 * grip)
    assert scene.front_force.end[1] == pytest.approx(geometry.LONGEST_ARROW * geometry.GRIP_ARROW)
    assert scene.rear_force.end[1] == pytest.approx(-geometry.LONGEST_ARROW * geometry.GRIP_ARROW)


@pytest.mark.parametrize(("part", "saturated"), [(0.9, False), (-0.9, False), (1.0, True), (-1.0, True), (-3.0, True)])
def test_saturated_axles_are_marked(part, saturated):
    env = env_at("BicycleStab-v0")
    scene = scene_of(env, front_lateral_force=part * setup_of(env).front_grip, rear_lateral_force=0.0)
    assert scene.front_force.saturated is saturated
    assert scene.rear_force.saturated is False


def test_the_travel_arrow_shows_where_the_centre_of_mass_goes():
    env = env_at("BicycleStab-v0", TURNED)
    start, end = scene_of(env).travel[:2]
    course = env.state.heading + math.atan(env.state.lateral_velocity / env.speed)
    assert math.atan2(end[1] - start[1], end[0] - start[0]) == pytest.approx(course, abs=1e-12)
    assert start == (37.0, 0.6)


def points_of(scene):
    """All points by name; the order within a shape does not matter, the order of two parts of a pair neither."""
    shapes = {name: [value] for name, value in scene._asdict().items() if name in SINGLE}
    shapes |= {name: list(getattr(scene, name)) for name in ("verge_stripes", "posts", "road_edges", "lane_dashes")}
    shapes |= {name: list(getattr(scene, name)) for name in ("path_dashes", "headlights", "taillights")}
    shapes |= {
        name: [[arrow.start], [arrow.end]] for name, arrow in scene._asdict().items() if isinstance(arrow, Arrow)
    }
    shapes |= {name: list(getattr(scene, name)) for name in ("ice", "obstacles", "tufts")}
    shapes |= {"cones": [scene.cones], "struck": [scene.struck], "outside": [scene.outside]}
    shapes["centre_of_mass"] = [[scene.centre_of_mass]]
    return shapes | {name: [wheel] for name, wheel in scene.wheels.items()}


SINGLE = ("corridor", "target_lane", "trail", "body", "windscreen", "rear_window")


def mirrored(shapes):
    swap = {"left": "right", "right": "left"}
    flipped = {}
    for name, parts in shapes.items():
        axle, _, side = name.partition("_")
        new_name = f"{axle}_{swap[side]}" if side in swap else name
        flipped[new_name] = [[(x, -y) for x, y in part] for part in parts]
    return flipped


def in_order(shapes):
    return {name: sorted(sorted(part) for part in parts) for name, parts in shapes.items()}


@pytest.mark.parametrize("env_id", IDS)
def test_a_mirrored_state_gives_the_mirrored_scene_exactly(env_id):
    reflected = {name: value if name == "longitudinal_position" else -value for name, value in TURNED.items()}
    sides = ({"direction": "left"}, {"direction": "right"}) if "Lane" in env_id else ({}, {})
    trail = ((30.0, 0.1), (33.0, 0.2))
    scene = scene_of(env_at(env_id, TURNED, **sides[0]), trail)
    other = scene_of(env_at(env_id, reflected, **sides[1]), tuple((x, -y) for x, y in trail))
    assert in_order(points_of(other)) == in_order(mirrored(points_of(scene)))
    assert (other.left, other.right, other.half_height) == (scene.left, scene.right, scene.half_height)
    assert other.middle == -scene.middle
    assert len(points_of(scene)) == len(scene) - 4 + 3  # four numbers aside, and four wheels in one field


def test_the_corridor_is_the_one_that_ends_the_episode():
    env = env_at("BicycleLaneChange-v0", direction="right")
    corridor = np.array(scene_of(env).corridor)
    assert (corridor[:, 1].min(), corridor[:, 1].max()) == (-5.25, 1.75)
    env = env_at("BicycleStab-v0")
    corridor = np.array(scene_of(env).corridor)
    assert (corridor[:, 1].min(), corridor[:, 1].max()) == (-1.75, 1.75)


@pytest.mark.parametrize(("direction", "low", "high"), [("left", 1.75, 5.25), ("right", -5.25, -1.75)])
def test_the_target_lane_is_where_the_car_shall_end(direction, low, high):
    scene = scene_of(env_at("BicycleLaneChange-v0", direction=direction))
    lane = np.array(scene.target_lane)
    assert (lane[:, 1].min(), lane[:, 1].max()) == (low, high)
    assert all(abs(y - scene.middle) <= 0.5 * geometry.LINE_WIDTH for dash in scene.lane_dashes for _, y in dash)
    assert scene.lane_dashes


def test_one_lane_has_no_target_lane_and_no_divider():
    scene = scene_of(env_at("BicycleStab-v0"))
    assert scene.target_lane == ()
    assert scene.lane_dashes == ()


def test_the_path_is_the_reference_of_the_task():
    env = env_at("BicycleLaneChange-v0", direction="right", duration=2.0)
    start, length = env.state.change_start, 2.0 * env.speed
    seen = []
    for x in (0.0, start + 0.3 * length, start + length):
        env.reset(seed=0, options={"state": {"longitudinal_position": x}, "direction": "right"})
        seen += [point for dash in scene_of(env).path_dashes for point in dash]
    for x, y in seen:
        s = min(max((x - start) / length, 0.0), 1.0)
        assert y == pytest.approx(-3.5 * s**3 * (10.0 - 15.0 * s + 6.0 * s * s), abs=1e-12)
    assert min(y for _, y in seen) == -3.5
    assert max(y for _, y in seen) == 0.0


@pytest.mark.parametrize("name", ["verge_stripes", "posts", "lane_dashes", "path_dashes"])
def test_marks_stay_on_the_road_while_the_car_passes(name):
    def starts(x):
        scene = scene_of(env_at("BicycleLaneChange-v0", {"longitudinal_position": x}, direction="left"))
        return {shape[0][0] for shape in getattr(scene, name)}, scene

    before, scene = starts(10.0)
    after, further = starts(13.7)
    assert further.left == pytest.approx(scene.left + 3.7)
    common = {x for x in before if further.left + 5.0 < x < scene.right - 5.0}
    assert len(common) > 1
    assert common == {x for x in after if further.left + 5.0 < x < scene.right - 5.0}
    for view in (scene, further):
        xs = sorted(shape[0][0] for shape in getattr(view, name))
        assert xs[0] < view.left + 10.0
        assert xs[-1] > view.right - 10.0


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("heading", [-1.2, 0.0, 1.2])
def test_a_car_on_the_point_of_leaving_is_all_in_the_picture(env_id, heading):
    env = env_at(env_id)
    edge = env.task.road_half_width + 0.5 * env.vehicle.body_width
    y = env.measure()["reference_road_centre"] + edge
    scene = scene_of(env_at(env_id, {"lateral_position": y, "heading": heading}))
    for x, y in scene.body:
        assert scene.left < x < scene.right
        assert abs(y - scene.middle) < scene.half_height


def test_an_arrow_has_its_tip_at_its_end():
    outline = arrow_outline(Arrow((1.0, 2.0), (1.0, 5.0)), 0.2)
    assert max(y for _, y in outline) == pytest.approx(5.0)
    assert min(y for _, y in outline) == pytest.approx(2.0)
    assert np.mean([x for x, _ in outline]) == pytest.approx(1.0)


def test_no_arrow_where_there_is_nothing_to_show():
    assert arrow_outline(Arrow((1.0, 2.0), (1.01, 2.0)), 0.2) == ()


def test_the_trail_ends_at_both_sides_of_the_picture():
    env = env_at(IDS[0], {})
    far = tuple((x, 0.0) for x in (-1e4, 0.0, 1e4))
    assert scene_of(env, far).trail == ((0.0, 0.0),)
