"""The page: its figures are those of analysis and control, its runs those of the environment, its Python runs."""

import dataclasses
import json
import math
import re
import shutil
import subprocess

import numpy as np
import pytest

import bicycle_env
from bicycle_env import analysis, control, explore, leaderboard
from bicycle_env.explore import answers
from bicycle_env.explore.answers import configuration, design, portrait, recoverable
from bicycle_env.explore.content import FOLDER
from bicycle_env.explore.server import POLICY
from bicycle_env.export.command import Uncompiled
from bicycle_env.files import FileError
from bicycle_env.tasks import Stabilise

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="no node here")


def data_of(files):
    return json.loads(files["data.mjs"].decode().removeprefix("export const data = ").rstrip(";\n"))


def test_the_speeds_are_those_of_the_environments(files):
    presets = data_of(files)["presets"]
    assert list(presets) == ["oversteer", "civic"]
    for name, preset in presets.items():
        critical = analysis.critical_speed(name)
        assert preset["critical_speed"] == (None if math.isinf(critical) else critical)
        for point in preset["points"]:
            assert point["metres_per_second"] == point.get("speed", point.get("speed_ratio", 0.0) * critical)


@pytest.mark.parametrize(("name", "k"), [("oversteer", 18), ("civic", 7)])
def test_the_gains_are_those_of_the_controller(name, k, files):
    point = data_of(files)["presets"][name]["points"][k]
    plant = Uncompiled(configuration(vehicle=name, speed=point["metres_per_second"]))
    gains = np.array(point["designs"]["lqr both"]["weights"])
    np.testing.assert_allclose(gains.T, control.make("lqr", plant).matrix, rtol=1e-9, atol=1e-12)
    law = control.REAR_LAWS["yaw-rate"](plant)
    assert point["designs"]["yaw-rate"]["rear"] == {"ratio": law.ratio, "yaw_rate_gain": law.yaw_rate_gain}


def test_the_page_asks_no_other_host_and_finds_its_parts():
    texts = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.iterdir()}
    assert not re.findall(r"https?:|//\w+\.\w+", "".join(texts.values()))
    assert f'content="{POLICY}"' in texts["index.html"]
    ids = set(re.findall(r' id="(\w+)"', texts["index.html"]))
    wanted = set(re.findall(r'\bat\("(\w+)"\)', "".join(texts.values())))
    assert len(wanted) > 25
    assert wanted <= ids
    laws = "".join(texts[name] for name in ("simulation.mjs", "car.mjs", "hand.mjs", "drivers.mjs", "designs.mjs"))
    assert not re.findall(r"Math\.(sin|tan|cos|atan|exp|log|sqrt)\(", laws), "a law beside the traced ones"


SCRIPT = """
import { fromHash, toHash, ending, DEGREE, moduleOf, placeOf, SIDES } from "./choices.mjs";
import { bodyOf, pointsOf, speedInWords, stabilityInWords, straight } from "./car.mjs";
import { data } from "./data.mjs";
import { driver } from "./drivers.mjs";
import { Hand } from "./hand.mjs";
import { asPython } from "./python.mjs";
import { grid, orbit, placed, run, started } from "./simulation.mjs";
import * as fs from "node:fs";
const { hash, stable, designs, files } = JSON.parse(fs.readFileSync("given.json"));
const { chosen, complaints } = fromHash(data, hash);
const task = await import(`./${moduleOf(chosen)}.mjs`);
const body = bodyOf(data, chosen), point = pointsOf(data, chosen)[chosen.point], speed = point.metres_per_second;
const world = placed(task, body, speed, placeOf(data, chosen)), found = straight(body, speed);
const start = [chosen.sideslip * DEGREE, chosen.yaw_rate * DEGREE];
const hand = new Hand(world.rules.control_timestep);
hand.press("ArrowLeft", true);
const design = (name) => ({ found: designs[name] ?? point.designs?.[name] });
const setting = { steer: chosen.steer, angle: chosen.angle * DEGREE, hand, design, names: data.observation_names };
Object.assign(setting, { env_id: data.env_id, file: files });
const runs = SIDES.map((side) => {
  const who = driver(chosen[side], { ...setting, rear: chosen[`${side}_rear`] });
  return who.why ? { why: who.why } : run(world, who, ...start);
});
const box = { sideslip: 0.5, yawRate: 1.2 };
console.log(JSON.stringify({
  chosen, complaints, endings: runs.map((one) => ending(data, one, chosen.area)), hash: toHash(data, chosen), speed,
  runs: runs.map(({ why, columns, end, settledAfter }) => ({ why, columns, end, settledAfter })),
  python: asPython(data, chosen, started(world, ...start).state, hand.steered),
  orbits: grid(box, 3).map((start) => orbit(world, stable, box, ...start, 1)),
}));
"""


def in_node(folder, hash, stable=False, designs=None, files=None):
    (folder / "script.mjs").write_text(SCRIPT)
    (folder / "given.json").write_text(
        json.dumps({"hash": hash, "stable": stable, "designs": designs or {}, "files": files})
    )
    done = subprocess.run([NODE, "script.mjs"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


OVERSTEER = "vehicle=oversteer&tire=fiala"
HASHES = (
    f"{OVERSTEER}&friction=0.9&left=lqr&right=policy&sideslip=8&yaw_rate=20&recoverable=off&speed_ratio=1.2",
    "vehicle=civic&tire=linear&friction=1&left=nobody&right=lqr&sideslip=-3&yaw_rate=0&recoverable=off&speed=40",
    f"{OVERSTEER}&friction=1&gust=-2000&left=you&right=policy&left_rear=policy&sideslip=1&yaw_rate=0&recoverable=off&speed_ratio=1.2",
)
CHANGED = (
    "vehicle=oversteer&mass=120&cg_to_front=95&rear_cornering_stiffness=90&tire=tanh&friction=0.8&steer=front&gust=1500"
    "&left=you&right=lqr&sideslip=2&yaw_rate=-5&recoverable=off&speed=38.5"
)
STRAIGHT = "sideslip=0&yaw_rate=0&recoverable=off&speed_ratio=1.2"
ACTUATORS = "front_angle_limit=5&front_rate_limit=30&rear_rate_limit=20&rear_time_constant=80"
DRIVEN = (
    f"{OVERSTEER}&friction=1&left=step&left_rear=yaw-rate&right=sine_with_dwell&right_rear=zero-sideslip&angle=-1.25"
    f"&{ACTUATORS}&{STRAIGHT}",
    f"{OVERSTEER}&friction=1&left=you&left_rear=speed-dependent&right=preview&right_rear=sano&rear_angle_limit=4"
    f"&{STRAIGHT.replace('sideslip=0', 'sideslip=2')}",
)
FIELD = (
    f"{OVERSTEER}&friction=0.8&area=field&relaxation_length=0.4&left=sine_with_dwell&right=step&right_rear=sano&angle=3"
    f"&{STRAIGHT}"
)
NAMES = {
    **{"nobody": "zero", "sine_with_dwell": "sine-with-dwell"},
    "policy": bicycle_env.load_policy("BicycleStab-v0").name,
}
"""What the page's words are called in Python, where it is another word."""


def parts_of(hash):
    return dict(pair.split("=") for pair in hash.split("&"))


def designs_for(hash):
    """What the server would be asked for by these addresses."""
    if hash == CHANGED:
        changes = {"mass": 1800.0, "cg_to_front": 1.33, "rear_cornering_stiffness": 81000.0}
        car = dataclasses.replace(bicycle_env.vehicles["oversteer"], **changes)
        return {"lqr front": design(car, 38.5, "lqr", "front")}
    if "preview" not in hash:
        return {}
    car = bicycle_env.vehicles["oversteer"]
    limits = (answers.FRONT, dataclasses.replace(answers.REAR, angle_limit=math.radians(4.0)))
    return {"preview+sano": design(car, 1.2 * car.critical_speed, "preview+sano", "both", limits)}


@needs_node
@pytest.mark.parametrize(
    "hash", [*HASHES, *DRIVEN, *(pytest.param(one, marks=pytest.mark.exhaustive) for one in (CHANGED, FIELD))]
)
def test_the_runs_are_the_environments_and_the_python_runs(hash, folder, capsys):
    """To rounding: the environment's multiply-add rounds once, and a network sums in single precision."""
    found = in_node(folder, f"#{hash}", designs=designs_for(hash))
    assert found["complaints"] == []
    assert parts_of(found["hash"].removeprefix("#")) == parts_of(hash)
    chosen, names = found["chosen"], {}
    exec(found["python"], names)
    env, start = names["env"], names["start"]
    said = capsys.readouterr().out.splitlines()
    assert env.unwrapped.speed == pytest.approx(found["speed"], rel=1e-15)
    assert start["lateral_velocity"] == pytest.approx(math.radians(chosen["sideslip"]) * found["speed"])
    assert start["yaw_rate"] == pytest.approx(math.radians(chosen["yaw_rate"]))
    for axle, actuator in (("front", env.unwrapped.front_actuator), ("rear", env.unwrapped.rear_actuator)):
        degrees = (chosen[f"{axle}_angle_limit"], chosen[f"{axle}_rate_limit"])
        assert (actuator.angle_limit, actuator.rate_limit) == tuple(map(math.radians, degrees))
        assert actuator.time_constant == chosen[f"{axle}_time_constant"] / 1000.0
    assert (env.unwrapped.relaxation_length or 0.0) == chosen["relaxation_length"]
    policies = eval(
        f"({re.search(r'for policy in [(](.*?)^[)]:', found['python'], re.DOTALL | re.MULTILINE)[1]})", names
    )
    drivers = dict(zip(("left", "right"), policies if len(policies) > 1 else 2 * policies, strict=True))
    for side, result, ending, line in zip(("left", "right"), found["runs"], found["endings"], said, strict=False):
        driver, columns = drivers[side], result["columns"]
        word, rear = NAMES.get(chosen[side], chosen[side]), chosen[f"{side}_rear"]
        assert driver.name == (word if word == "you" or rear == "nobody" else f"{word}+{rear}")
        driver.reset()
        observation, _ = env.reset(options={"state": start})
        rows, over = [env.unwrapped.state], False
        while not over:
            observation, _, terminated, truncated, info = env.step(driver.act(observation))
            over = terminated or truncated
            rows.append(env.unwrapped.state)
        assert len(columns["time"]) == len(rows)
        assert result["end"] == info["end"]
        assert columns["time"][-1] == pytest.approx(env.unwrapped.state.time)
        for name in ("lateral_position", "heading", "lateral_velocity", "yaw_rate", "front_steer", "rear_steer"):
            np.testing.assert_allclose(columns[name], [getattr(row, name) for row in rows], rtol=0.0, atol=2e-5)
        assert ending.startswith(("spun", "left")) == bool(info["end"])
        assert f" {env.unwrapped.state.time if info['end'] else result['settledAfter'] or 8.0:.2f} s" in ending
        assert (result["settledAfter"] is not None) == info["is_success"]
        assert str(env.unwrapped.state.time) in line
    if chosen["left"] == "you":
        wheel = drivers["left"].wheel
        assert len(wheel) == len(found["runs"][0]["columns"]["time"]) - 1
        assert max(wheel) > 0.0


@needs_node
def test_orbits_are_the_cars(folder):
    found = in_node(folder, f"#{HASHES[0]}")
    corner, middle = found["orbits"][0], found["orbits"][4]
    assert middle["points"] == [[0.0, 0.0]] * 51
    speed = found["speed"]
    start = {"lateral_velocity": corner["points"][0][0] * speed, "yaw_rate": corner["points"][0][1]}
    run = bicycle_env.simulate("oversteer", speed, (0.0, 0.0), 1.0, friction=0.9, initial_state=start, timestep=0.004)
    count = len(corner["points"])
    assert count > 5
    np.testing.assert_allclose(
        np.array(corner["points"]).T,
        [run["lateral_velocity"][: 5 * count : 5] / speed, run["yaw_rate"][: 5 * count : 5]],
        rtol=1e-9,
    )
    assert not any(orbit["settled"] for orbit in found["orbits"])
    assert any(orbit["settled"] for orbit in in_node(folder, f"#{HASHES[1]}", stable=True)["orbits"])


@needs_node
def test_an_address_that_is_not_understood_is_said(folder):
    found = in_node(folder, "#vehicle=bus&friction=7&sideslip=&speed_ratio=1.234")
    assert len(found["complaints"]) == 4
    assert "there are oversteer, civic" in found["complaints"][0]
    assert "in 0.1 to 1.2" in found["complaints"][1]
    assert found["chosen"]["vehicle"] == "oversteer"
    assert "speed_ratio=1.25" in found["hash"]
    found = in_node(folder, "#left=step&left_rear=lqr&right_rear=sano&relaxation_length=0.1&area=moon&angle=x")
    assert len(found["complaints"]) == 4
    assert "left_rear “lqr”, which goes with you at the wheel only" in found["complaints"][-1]
    assert "must be 0, or in 0.2 to 1.2" in " ".join(found["complaints"])
    assert [found["chosen"][name] for name in ("left_rear", "right_rear")] == ["nobody", "sano"]


@needs_node
@pytest.mark.exhaustive
def test_the_python_has_the_phase_plane_too(folder, capsys):
    found = in_node(
        folder, f"#{OVERSTEER}&friction=0.8&steer=front&left=nobody&right=nobody&sideslip=6&speed_ratio=0.9"
    )
    names = {}
    exec(found["python"], names)
    car, speed = bicycle_env.vehicles["oversteer"], found["speed"]
    turns = portrait(car, speed, "fiala", 0.8)["equilibria"]
    known = recoverable(car, speed, "fiala", 0.8, "front", lambda _: None)
    bits = [f"{int(row, 16):0{known['nodes']}b}" for row in known["rows"]]
    saved = np.isfinite(names["saved"].least_time).T.astype(int).tolist()
    assert ["".join(map(str, row)) for row in saved] == bits
    said = capsys.readouterr().out
    assert len(turns) == 3
    assert said.count("kind='saddle'") == [turn["kind"] for turn in turns].count("saddle")
    assert said.splitlines()[-1] == str(bool(names["saved"].contains(speed * math.radians(6.0), 0.0)))


@needs_node
def test_the_python_loads_a_policy_of_ones_own(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    bicycle_env.load_policy("BicycleStab-v0").save("policy")
    for left in ("file", "policy"):
        exec(in_node(folder, f"#{OVERSTEER}&left={left}&right={left}&recoverable=off")["python"], {})
    said = capsys.readouterr().out.splitlines()
    assert said[: len(said) // 2] == said[len(said) // 2 :]


@needs_node
def test_who_cannot_drive_says_why(folder):
    found = in_node(folder, "#vehicle=oversteer&mass=110&steer=rear&left=you&right=lqr")
    assert "a driver has the front axle" in found["endings"][0]
    assert "start “bicycle-env explore”" in found["endings"][1]
    found = in_node(folder, "#vehicle=oversteer&steer=front&left=file&right=policy")
    assert "no policy file yet" in found["endings"][0]
    assert "steers both axles" in found["endings"][1]


@needs_node
def test_a_policy_of_another_task_is_told_apart_by_what_it_sees_before_its_axles(folder):
    other = {"names": ["speed", "gap"], "env_id": "BicycleEvade-v0", "layers": [{"weight": [[0, 0]], "bias": [0]}]}
    found = in_node(folder, "#vehicle=oversteer&steer=both&left=file", files=other)
    said = (
        "this policy was trained for BicycleEvade-v0, and does not see what BicycleStab-v0 shows it: 2 entries, not 8"
    )
    assert found["endings"][0] == said


TOLERANCES = Stabilise.tolerances
WITHIN = "(within 0.5 m, 1.1 deg and 2.9 deg/s)"


@needs_node
def test_an_ending_says_what_straight_means_and_how_the_car_slid(folder, files):
    assert data_of(files)["tolerances"] == dataclasses.asdict(TOLERANCES)
    at_edge = in_node(folder, "#vehicle=oversteer&left=lqr&right=lqr&sideslip=16&yaw_rate=7&speed_ratio=1.2")
    sliding = math.degrees(at_edge["runs"][0]["columns"]["sideslip"][-1])
    assert abs(sliding) > 30.0
    assert at_edge["endings"][0].startswith("left its lane after")
    assert at_edge["endings"][0].endswith(f"s, with {abs(sliding):.0f} deg of sideslip")
    gust = in_node(folder, "#vehicle=oversteer&left=lqr&right=nobody&sideslip=0&yaw_rate=0&gust=3000&speed_ratio=1.2")
    assert gust["endings"][0] == f"runs straight from 0.00 s on {WITHIN}"


@needs_node
def test_on_a_field_a_car_that_recovers_by_itself_runs_straight_again(folder):
    found = in_node(folder, "#vehicle=civic&left=nobody&right=step&sideslip=4&area=field&speed=20")
    alone, columns = found["endings"][0], found["runs"][0]["columns"]
    moves = np.abs(columns["sideslip"]) >= TOLERANCES.sideslip
    moves |= np.abs(columns["yaw_rate"]) >= TOLERANCES.yaw_rate
    first = columns["time"][np.flatnonzero(moves)[-1] + 1]
    assert alone == f"has not spun in 8.00 s; runs straight again from {first:.2f} s on, but not on its old line"
    assert found["endings"][1] == "has not spun in 8.00 s"  # it turns on


def test_the_comparison_of_the_policy_is_the_leaderboards(files):
    rows = leaderboard.read()["levels"]["BicycleStab-v0 medium"]["rows"]
    said = data_of(files)["compared"]
    for name in ("pretrained", "lqr, as shipped", "best found"):
        (row,) = (row for row in rows if row["name"] == name)
        assert f"{100 * row['success_rate']['value']:.1f} % (95 % interval" in said
    assert "the learned policy and LQR do equally well, as far as these starts tell: in the end" in said


def test_the_wheel_turns_as_that_of_play(files):
    human = pytest.importorskip("bicycle_env.play.human")
    found = dict(re.findall(r"export const (TURN|RETURN) = (\d+)", files["hand.mjs"].decode()))
    assert {name: float(value) for name, value in found.items()} == {"TURN": human.TURN, "RETURN": human.RETURN}


def test_the_folder_is_written_and_not_over_others(files, tmp_path, monkeypatch):
    monkeypatch.setattr("bicycle_env.explore.page", lambda names: files)
    paths = explore.write(tmp_path)
    assert {path.name: path.read_bytes() for path in paths} == files
    assert sum(map(len, files.values())) < 1_000_000
    explore.write(tmp_path)
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(FileError, match=r"index.html: is there, and is not what `bicycle-env explore` has written"):
        explore.write(tmp_path)
