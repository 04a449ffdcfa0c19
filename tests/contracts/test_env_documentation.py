"""The class docstrings are the documentation: each number in them is the number that is used."""

import ast
import importlib
import inspect
import math
import re

import gymnasium as gym
import pytest

from bicycle_env import Actuator, tires, vehicles
from bicycle_env.envs.configuration import DEFAULT_SPEED
from bicycle_env.envs.many import block_kernels
from bicycle_env.envs.single.single_track_env import keyword_names
from bicycle_env.physics.car import CarState
from bicycle_env.registration import ENVIRONMENTS
from bicycle_env.tasks import evade as evasion
from bicycle_env.tasks import fmvss126, steadiness
from bicycle_env.tasks.double_lane_change import APPROACH, COURSES
from bicycle_env.tasks.lane_change import DURATION


class Documented:
    """One id: its environment, its docstring on one line per paragraph, and its tables."""

    def __init__(self, row):
        self.row = row
        module, name = row.entry_point.split(":")
        self.cls = getattr(importlib.import_module(module), name)
        self.env = gym.make(row.id).unwrapped
        self.doc = inspect.getdoc(self.cls)
        self.text = re.sub(r"\s+", " ", self.doc)

    def section(self, heading):
        found = re.search(rf"^## {heading}\n(.*?)(?=^## |\Z)", self.doc, flags=re.MULTILINE | re.DOTALL)
        assert found, heading
        return found.group(1)

    def table(self, heading):
        lines = [line for line in self.section(heading).splitlines() if line.startswith("|")]
        rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
        assert len(rows) > 2, heading
        assert all(len(row) == len(rows[0]) for row in rows)
        return [dict(zip(rows[0], row, strict=True)) for row in rows[2:]]

    def parameters(self):
        """Keyword -> default, from the signatures."""
        own = {
            name: parameter.default
            for name, parameter in inspect.signature(self.cls).parameters.items()
            if parameter.kind is parameter.KEYWORD_ONLY
        }
        task = {
            name: parameter.default
            for name, parameter in inspect.signature(type(self.cls.default_task)).parameters.items()
        }
        return own | task

    def has(self, text):
        assert text in self.text, text


@pytest.fixture(params=ENVIRONMENTS, ids=lambda row: row.id, scope="module")
def page(request):
    return Documented(request.param)


@pytest.fixture
def stab():
    return Documented(ENVIRONMENTS[0])


@pytest.fixture
def lane_change():
    return Documented(ENVIRONMENTS[1])


@pytest.fixture
def double_lane_change():
    return Documented(next(row for row in ENVIRONMENTS if row.id == "BicycleDoubleLaneChange-v0"))


@pytest.fixture
def active_steer():
    return Documented(next(row for row in ENVIRONMENTS if row.id == "BicycleActiveSteer-v0"))


@pytest.fixture
def evade():
    return Documented(next(row for row in ENVIRONMENTS if row.id == "BicycleEvade-v0"))


def test_every_section_is_there(page):
    for heading in (
        "Description",
        "Action space",
        "Observation space",
        "Reward",
        "Starting state",
        "Episode end",
        "Info",
        "Arguments",
        "Version history",
    ):
        assert page.section(heading).strip()
    assert "v0" in page.section("Version history")


# Arguments


def documented_default(cell):
    text = cell.strip("`")
    actuator = re.fullmatch(r"Actuator\((\S+) deg, (\S+) deg/s, (\S+) s\)", text)
    if actuator:
        angle, rate, lag = map(float, actuator.groups())
        return Actuator(math.radians(angle), math.radians(rate), lag)
    return ast.literal_eval(text)


def test_the_table_of_arguments_is_the_signature(page):
    table = {row["Keyword"]: documented_default(row["Default"]) for row in page.table("Arguments")}
    assert list(table) == keyword_names(page.cls)
    parameters = page.parameters()
    assert set(table) == set(parameters)
    for name, default in table.items():
        assert default == parameters[name], name
        assert type(default) is type(parameters[name]), name


def test_every_argument_is_explained(page):
    assert all(row["Meaning"] for row in page.table("Arguments"))


def test_the_meanings_name_the_defaults_that_none_stands_for(page):
    meaning = {row["Keyword"]: row["Meaning"] for row in page.table("Arguments")}
    assert f"the time limit, or {page.env.horizon}, by default" in meaning["horizon"]
    assert page.env.horizon == page.row.max_episode_steps == page.env.task.episode_steps
    if page.env.task.usual_speed is None:
        ratio = page.env.speed / page.env.vehicle.critical_speed
        assert f"{ratio:.12g} if neither is given" in meaning["speed_ratio"]
        assert f"{DEFAULT_SPEED:g} if neither is given and the vehicle has no critical speed" in meaning["speed"]
    for words, keyword in (
        (tires.LAWS, "tire"),
        (("front", "rear", "both"), "steer"),
        (("small_angle", "exact"), "geometry"),
        (page.env.task.rewards, "reward"),
        (page.env.task.levels, "level"),
        (("human", "rgb_array"), "render_mode"),
    ):
        named = re.findall(r'`"(\w+)"`', meaning[keyword])
        assert named == list(words), f"name them in envs/arguments.py, or in {page.cls.__name__}.meanings: {keyword}"


def test_the_meanings_of_the_lane_change(lane_change):
    meaning = {row["Keyword"]: row["Meaning"] for row in lane_change.table("Arguments")}
    env = lane_change.env
    path = env.task.settings(env.speed)
    assert re.findall(r'`"(\w+)"`', meaning["direction"]) == ["left", "right", "random"]
    early, late = path.earliest_start / env.speed, path.latest_start / env.speed
    assert f"uniform in {early:g} to {late:g}" in meaning["change_start"]
    assert f"{path.change_length / env.speed:g} by default" in meaning["duration"]
    lane_change.has(f"In the default {path.change_length / env.speed:g} s")


def test_the_meanings_of_the_double_lane_change(double_lane_change):
    meaning = {row["Keyword"]: row["Meaning"] for row in double_lane_change.table("Arguments")}
    first, second = COURSES.values()
    assert re.findall(r'`"([\w-]+)"`', meaning["course"]) == list(COURSES)
    assert re.findall(r'`"(\w+)"`', meaning["direction"]) == ["left", "right", "random"]
    assert f"{first.speed:.1f} on the first course, {second.speed:g} on the second" in meaning["speed"]
    double_lane_change.has(f"{3.6 * first.speed:.0f} km/h on the first course and {3.6 * second.speed:.0f} km/h on")


def test_the_courses_are_those_of_the_table(double_lane_change):
    rows = double_lane_change.table("Description")
    assert [row["course"] for row in rows] == list(COURSES)
    for row, course in zip(rows, COURSES.values(), strict=True):
        lengths = row["sections 1, 2, ... [m]"].replace(" +", ",")
        assert tuple(map(float, lengths.split(", "))) == course.lengths
        for number, share, more in zip("135", course.widths[::2], course.widths[1::2], strict=True):
            words = "w" if share == 1.0 else f"{share:g} w"
            at_least = f", at least {course.least_5:g} m" if number == "5" and course.least_5 else ""
            assert row[f"lane {number}"] == f"{words} + {more:g} m{at_least}"
        assert row["offset"] == f"{course.offset:g} m"
    double_lane_change.has(f"Lane 1 begins {APPROACH:g} s after the start")
    double_lane_change.has(f"a strip {2.0 * double_lane_change.env.task.road_half_width:g} m wide is free")


def test_the_slowest_cars_that_pass_within_the_time(double_lane_change):
    found = re.search(r"at least (\S+) m/s on the first course and (\S+) m/s on the second", double_lane_change.text)
    seconds = double_lane_change.row.max_episode_steps * double_lane_change.env.control_timestep
    for course, words in zip(COURSES, found.groups(), strict=True):
        for speed, passes in ((float(words), True), (float(words) - 0.1, False)):
            env = gym.make(double_lane_change.row.id, course=course, speed=speed).unwrapped
            assert (env.task.seconds_to_pass(env.configuration.car) < seconds) is passes


# Spaces


def test_the_table_of_observations(page):
    env = page.env
    rows = page.table("Observation space")
    listed = []
    for row in rows:
        if "-" in row["Num"]:
            first, last = map(int, row["Num"].split("-"))
            begin, end = re.fullmatch(r"preview_(\S+)s \.\.\. preview_(\S+)s", row["Observation"]).groups()
            count = last - first + 1
            assert first == len(listed)
            times = [float(begin) + k * (float(end) - float(begin)) / (count - 1) for k in range(count)]
            listed += [{**row, "Observation": f"preview_{time:g}s"} for time in times]
        else:
            assert int(row["Num"]) == len(listed)
            listed.append(row)
    scales = {
        "0.2 x speed": 0.2 * env.speed,
        "speed": env.speed,
        "front angle limit": env.front_actuator.angle_limit,
        "rear angle limit": env.rear_actuator.angle_limit,
    }
    assert [row["Observation"] for row in listed] == [entry.name for entry in env.observation_entries]
    assert tuple(row["Observation"] for row in listed) == env.observation_names
    for row, entry, scale, bound in zip(
        listed, env.observation_entries, env.observation_scale, env.observation_space.high, strict=True
    ):
        assert row["Unit"] == entry.unit, row
        documented = scales[row["Scale"]] if row["Scale"] in scales else float(row["Scale"])
        assert documented == pytest.approx(entry.scale, rel=1e-15), row
        assert entry.scale == scale
        assert float(row["Bound"]) == entry.bound == bound, row
    assert f"`Box({len(listed)},)`" in page.section("Observation space")
    *first, last = [entry.name for entry in env.observation_entries if entry.mirror > 0.0] or [""]
    page.has(
        "All entries change sign in the mirror image" + (f", but for {', '.join(first)} and {last}." if last else ".")
    )


def test_the_table_of_actions(page):
    env = page.env
    actuators = (env.front_actuator, env.rear_actuator)
    rows, names = page.table("Action space"), env.linear_model().input_names
    assert [row["Action"] for row in rows] == list(names)
    steered = [actuators[name.startswith("rear")] for name in names]
    for k, (row, actuator) in enumerate(zip(rows, steered, strict=True)):
        assert int(row["Num"]) == k
        assert row["1 means (default actuators)"] == f"{math.degrees(actuator.angle_limit):g} deg at the road wheels"
    assert f"`Box(-1, 1, {env.action_space.shape}, float32)`" in page.section("Action space")
    assert actuators[0].time_constant == actuators[1].time_constant
    page.has(
        f"first-order lag ({actuators[0].time_constant:g} s) and a rate limit "
        f"(front {math.degrees(actuators[0].rate_limit):g} deg/s, rear {math.degrees(actuators[1].rate_limit):g} deg/s)"
    )


# Reward, start, end


def test_the_default_reward_of_stab(stab):
    rules = stab.env.reward
    stab.has(
        f"c = {rules.lateral_weight} y^2 + {rules.heading_weight} psi^2 + {rules.sideslip_weight} beta^2 + "
        f"{rules.yaw_rate_weight} r^2 + {rules.effort_weight} |u|^2 + {rules.smoothness_weight} |du|^2"
    )


@pytest.mark.parametrize("id", ["lane_change", "double_lane_change"])
def test_the_default_reward_on_a_path(id, request):
    described = request.getfixturevalue(id)
    rules = described.env.reward
    described.has(
        f"c = {rules.lateral_weight} e_y^2 + {rules.heading_weight} e_psi^2 + {rules.sideslip_weight} beta^2 + "
        f"{rules.yaw_rate_weight} r^2 + {rules.effort_weight} |u|^2 + {rules.smoothness_weight} |du|^2"
    )


def test_the_quadratic_reward(page):
    rules, model = page.env.configuration.costs, page.env.linear_model()
    costs = (
        rules.lateral_cost,
        rules.heading_cost,
        rules.lateral_velocity_cost,
        rules.yaw_rate_cost,
        rules.front_steer_cost,
        rules.rear_steer_cost,
    )
    commands = [getattr(rules, name.replace("_steer_command", "_command_cost")) for name in model.input_names]
    page.has(f"Q = diag({', '.join(map(str, costs))}), R = diag({', '.join(map(str, commands))})")
    assert tuple(model.Q.diagonal()) == costs
    assert list(model.R.diagonal()) == commands
    order = re.search(r"x = \(([^)]*)\)", page.text).group(1).replace("lateral_error", "lateral_position")
    assert tuple(order.replace("heading_error", "heading").split(", ")) == model.state_names


def test_the_start_of_stab(stab):
    box = stab.env.task.settings(stab.env.speed)
    stab.has(
        f"lateral_position in +-{box.lateral_position} m, course (heading + sideslip) in +-{box.course} rad, sideslip "
        f"in +-{box.sideslip} rad, yaw_rate in +-{box.yaw_rate} rad/s"
    )


def test_the_start_of_the_lane_change(lane_change):
    env = lane_change.env
    path = env.task.settings(env.speed)
    early, late = path.earliest_start / env.speed, path.latest_start / env.speed
    lane_change.has(
        f"lateral_position in +-{path.offset} m, heading in +-{path.heading} rad, the change begins {early:.3g} to "
        f"{late:.3g} s after the start"
    )


def test_the_start_of_the_double_lane_change(double_lane_change):
    env = double_lane_change.env
    numbers = env.task.settings(env.speed)
    double_lane_change.has(
        f"lateral_position in +-{numbers.lateral_start} m, heading in +-{numbers.heading_start} rad, the second lane"
    )


def test_the_limits(page):
    limits = page.env.task.limits
    page.has(
        f"|sideslip| > {limits.sideslip}, |yaw rate| > {limits.yaw_rate} rad/s or |heading| > {limits.heading} rad"
    )
    seconds = page.row.max_episode_steps * page.env.control_timestep
    page.has(f"Truncated after {page.row.max_episode_steps} steps ({seconds:g} s)")
    assert all(f'- `"{word}"`' in page.section("Episode end") for word in page.env.task.ends)
    assert '- `"spun"`' in page.section("Episode end")


def test_the_lane_of_stab(stab):
    half = stab.env.task.road_half_width
    stab.has(f"the lane, {2 * half} m wide: |lateral_position| > {half} m + half the body")


def test_the_tolerances_of_stab(stab):
    within = stab.env.task.tolerances
    stab.has(
        f"|lateral_position| < {within.lateral} m, |heading| < {within.heading}, |sideslip| < "
        f"{within.sideslip} and |yaw rate| < {within.yaw_rate} rad/s"
    )


def test_the_tolerances_of_the_lane_change(lane_change):
    within = lane_change.env.task.tolerances
    lane_change.has(
        f"within {within.lateral} m of the new lane's middle with |heading| < {within.heading}, "
        f"|sideslip| < {within.sideslip} and |yaw rate| < {within.yaw_rate} rad/s"
    )


def test_the_numbers_of_the_active_steer(active_steer):
    env, rules = active_steer.env, active_steer.env.reward
    active_steer.has(
        f"c = {rules.yaw_rate_weight} (r - r_ref)^2 + {rules.sideslip_weight} max(0, |beta| - {rules.free_sideslip})^2 "
        f"+ {rules.smoothness_weight} |du|^2 + after {rules.settling_weight} (r^2 + beta^2)"
    )
    active_steer.has(
        f"r_ref = (U / L) d / (1 + {steadiness.UNDERSTEER} U^2), within +-{steadiness.GRIP_SHARE} friction g / U"
    )
    active_steer.has(f"{rules.scale} / (1 + c)")
    active_steer.has(f"in the {steadiness.SETTLING} s after the driver")
    active_steer.has(f"cost {rules.failure} each, once")
    task = env.task
    (slow, fast), (slippery, grippy), (small, large) = task.relative_speed, task.relative_friction, task.amplitude
    active_steer.has(
        f"speed {slow} to {fast} of the nominal one, friction {slippery} to {grippy} of the nominal one, amplitude "
        f"{small} to {large} rad at the road wheels; frequency {task.frequency[0]} Hz and dwell {task.dwell[0]} s"
    )
    active_steer.has(f"{fmvss126.BEGIN} s after the start the front wheels begin")
    active_steer.has(f"{task.road_half_width} m to the side")
    active_steer.has(
        f"at most {fmvss126.FIRST_RATIO} of its peak at the control step {fmvss126.FIRST_TIME} s after the driver had "
        f"finished, and at most {fmvss126.SECOND_RATIO:g} of it from {fmvss126.SECOND_TIME} s after it to the end"
    )
    active_steer.has(
        f"since {fmvss126.PEAK_FROM} periods after the beginning, and counts at least {fmvss126.FLOOR} rad/s"
    )
    active_steer.has(
        f"{fmvss126.DISPLACEMENT_TIME} s after the beginning was at least {fmvss126.TWIN_SHARE} of the one that"
    )
    active_steer.has(f"its {fmvss126.LEAST_DISPLACEMENT} m")


def test_the_options_of_the_active_steer(active_steer):
    found = re.search(r"`reset\(options=(\{.*?\})\)`", active_steer.text.replace("{...}", "{}")).group(1)
    options = ast.literal_eval(found)
    assert set(options) == {"state", *active_steer.env.task.options}
    active_steer.env.reset(options=options)
    assert active_steer.env.state.amplitude == options["amplitude"]
    assert active_steer.env.state.speed == options["relative_speed"] * active_steer.env.speed


def test_the_numbers_of_the_evasion(evade):
    env, rules, task, within = evade.env, evade.env.reward, evade.env.task, evade.env.task.tolerances
    evade.has(
        f"c = {rules.outside_weight} max(0, {rules.margin} - d)^2 + {rules.sideslip_weight} beta^2 + "
        f"{rules.yaw_rate_weight} r^2 + {rules.effort_weight} |u|^2 + {rules.smoothness_weight} |du|^2"
    )
    evade.has(f"{rules.settling_weight} (psi^2 + beta^2 + 0.25 r^2) more")
    evade.has(f"and {rules.share_after_touch} of it after a touch")
    start = evasion.START
    evade.has(
        f"lateral_position in +-{start['lateral_position']} m, heading in +-{start['heading']} rad, sideslip in "
        f"+-{start['sideslip']} rad, yaw_rate in +-{start['yaw_rate']} rad/s, friction {task.relative_friction[0]} to "
        f"{task.relative_friction[1]} of the nominal one"
    )
    rows = evade.table("Description")
    for row, name in zip(rows, ("obstacle_time", "obstacle_length", "return_time"), strict=False):
        low, high = getattr(task, name)
        assert row["until"].endswith(f", {low:g} to {high:g} s")
    evade.has(f"Two lanes are {evasion.LANE_WIDTH} m wide each")
    evade.has(f"{task.judged_points} points along each side")
    evade.has(f"more than {evasion.FAR_OUTSIDE} m outside")
    evade.has(
        f"whole last {task.settled_seconds} s, |heading| < {within.heading}, |sideslip| < {within.sideslip} and "
        f"|yaw rate| < {within.yaw_rate} rad/s"
    )
    assert env.steer == "front"


def test_the_options_of_the_evasion(evade):
    found = re.search(r"`reset\(options=(\{.*?\})\)`", evade.text.replace("{...}", "{}")).group(1)
    options = ast.literal_eval(found)
    assert set(options) == {"state", *evade.env.task.options}
    evade.env.reset(options=options)
    for name, value in options.items():
        if name not in ("state", "direction"):
            assert getattr(evade.env.state, name) == value
    assert evade.env.state.side == 1.0


def test_the_peak_acceleration_of_the_path(lane_change):
    # The second derivative of 10 s^3 - 15 s^4 + 6 s^5 is largest at s = (1 - 1/sqrt 3)/2, where it is 10/sqrt 3.
    env = lane_change.env
    peak = 10.0 / math.sqrt(3.0) * env.task.lane_width / DURATION**2
    lane_change.has(f"peak lateral acceleration is {peak:.0f} m/s^2")


# Info, state, options


def test_the_telemetry_is_listed(page, monkeypatch):
    section = re.sub(r"\s+", " ", page.section("Info"))
    plain = page.env.reset(seed=0)[1]
    assert set(re.findall(r"`(\w+)` \(", section)) == set(plain)
    env = gym.make(page.row.id, telemetry=True)
    # The names are the same whatever is measured: nothing is compiled for them.
    monkeypatch.setattr(block_kernels, "measuring", lambda kind: lambda numbers, out: out.fill(1.0))
    listed = section.split("also: ")[1]
    listed = re.sub(r"\([^()]*(?:\([^()]*\))?[^()]*\)|\[[^\]]*\]", "", listed)
    assert set(re.findall(r"\w+", listed)) == set(env.reset(seed=0)[1]) - set(plain)


def test_the_settable_state_names(stab):
    listed = re.search(r"Settable: ([\w, ]+)\.", stab.text).group(1).split(", ")
    assert listed == [*CarState._fields, "front_steer_command", "rear_steer_command"]
    env = stab.env
    for name in listed:
        env.reset(options={"state": {name: 0.01}})
        assert getattr(env.state, name) == 0.01


@pytest.mark.parametrize("id", ["lane_change", "double_lane_change"])
def test_the_options_of_a_change(id, request):
    described = request.getfixturevalue(id)
    found = re.search(r"`reset\(options=(\{.*?\})\)`", described.text.replace("{...}", "{}")).group(1)
    options = ast.literal_eval(found)
    assert set(options) == {"state", *described.env.task.options}
    described.env.reset(options=options)


def test_the_default_speed(page):
    if page.env.task.usual_speed is not None:
        assert page.env.speed == page.env.task.usual_speed
        return
    assert "1.2 times the critical speed" in page.text or "above its critical speed" in page.text
    assert page.env.speed == 1.2 * vehicles["oversteer"].critical_speed
