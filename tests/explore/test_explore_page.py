"""The page: its figures are those of analysis and control, its runs those of the environment, its Python runs."""

import json
import math
import re
import shutil
import subprocess

import gymnasium as gym
import numpy as np
import pytest

import bicycle_env
from bicycle_env import analysis, control, explore
from bicycle_env.explore.content import FOLDER
from bicycle_env.explore.server import POLICY
from bicycle_env.files import FileError

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="no node here")


def data_of(files):
    return json.loads(files["data.mjs"].decode().removeprefix("export const data = ").rstrip(";\n"))


def test_the_figures_are_analysis(files):
    presets = data_of(files)["presets"]
    assert list(presets) == ["oversteer", "civic"]
    for name, preset in presets.items():
        critical = analysis.critical_speed(name)
        assert preset["critical_speed"] == (None if math.isinf(critical) else critical)
        for point in preset["points"]:
            speed = point["metres_per_second"]
            assert speed == point.get("speed", point.get("speed_ratio", 0.0) * critical)
            found = np.array([complex(*pair) for pair in point["eigenvalues"]])
            wanted = np.sort_complex(analysis.eigenvalues(name, speed))
            np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)
            sentence, doubling = point["sentence"], analysis.modes(name, speed).time_to_double
            assert analysis.classification(name) in sentence
            assert (f"doubles in {doubling:.2f} s" in sentence) == math.isfinite(doubling)
            assert ("is stable" in sentence) == analysis.is_stable(name, speed)
            assert point["heading"].startswith(f"{3.6 * speed:.0f} km/h")


@pytest.mark.parametrize(("name", "k"), [("oversteer", 18), ("civic", 7)])
def test_the_gains_are_those_of_the_controller(name, k, files):
    point = data_of(files)["presets"][name]["points"][k]
    env = gym.make("BicycleStab-v0", vehicle=name, speed=point["metres_per_second"]).unwrapped
    np.testing.assert_allclose(np.array(point["lqr"]).T, control.make("lqr", env).matrix, rtol=1e-12, atol=1e-12)


def test_the_page_asks_no_other_host_and_finds_its_parts():
    texts = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.iterdir()}
    assert not re.findall(r"https?:|//\w+\.\w+", "".join(texts.values()))
    assert f'content="{POLICY}"' in texts["index.html"]
    ids = set(re.findall(r' id="(\w+)"', texts["index.html"]))
    wanted = set(re.findall(r'\bat\("(\w+)"\)', texts["main.mjs"]))
    assert len(wanted) > 15
    assert wanted <= ids
    assert not re.findall(r"Math\.(sin|tan|cos|atan)\(", texts["simulation.mjs"]), "a law beside the traced ones"


SCRIPT = """
import { asPython, fromHash, toHash, ending, DEGREE } from "./choices.mjs";
import { data } from "./data.mjs";
import { driver, grid, orbit, placed, run, started } from "./simulation.mjs";
import * as fs from "node:fs";
const { hash, stable } = JSON.parse(fs.readFileSync("given.json"));
const { chosen, complaints } = fromHash(data, hash);
const task = await import(`./task_${chosen.tire}.mjs`);
const preset = data.presets[chosen.vehicle], point = preset.points[chosen.point];
const world = placed(task, preset, point, chosen.friction);
const start = [chosen.sideslip * DEGREE, chosen.yaw_rate * DEGREE];
const runs = [chosen.left, chosen.right].map((word) => run(world, driver(word, point), ...start));
const box = { sideslip: 0.5, yawRate: 1.2 };
console.log(JSON.stringify({
  chosen, complaints, runs, endings: runs.map(ending), hash: toHash(data, chosen), speed: point.metres_per_second,
  python: asPython(data, chosen, started(world, ...start).state),
  orbits: grid(box, 3).map((start) => orbit(world, stable, box, ...start, 1)),
}));
"""


def in_node(folder, hash, stable=False):
    (folder / "script.mjs").write_text(SCRIPT)
    (folder / "given.json").write_text(json.dumps({"hash": hash, "stable": stable}))
    done = subprocess.run([NODE, "script.mjs"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


HASHES = (
    "vehicle=oversteer&tire=fiala&friction=0.9&left=lqr&right=policy&sideslip=8&yaw_rate=20&speed_ratio=1.2",
    "vehicle=civic&tire=linear&friction=1&left=nobody&right=lqr&sideslip=-3&yaw_rate=0&speed=40",
)


@needs_node
@pytest.mark.parametrize("hash", HASHES)
def test_the_runs_are_the_environments_and_the_python_runs(hash, folder, capsys):
    """To rounding: the environment's multiply-add rounds once, and a network sums in single precision."""
    found = in_node(folder, f"#{hash}")
    assert found["complaints"] == []
    assert found["hash"] == f"#{hash}"
    chosen, names = found["chosen"], {}
    exec(found["python"], names)
    env, start = names["env"], names["start"]
    said = capsys.readouterr().out.splitlines()[1:]
    assert env.unwrapped.speed == pytest.approx(found["speed"], rel=1e-15)
    assert start["lateral_velocity"] == pytest.approx(math.radians(chosen["sideslip"]) * found["speed"])
    assert start["yaw_rate"] == pytest.approx(math.radians(chosen["yaw_rate"]))
    drivers = {
        "nobody": control.make("zero", env.unwrapped),
        "lqr": control.make("lqr", env.unwrapped),
        "policy": bicycle_env.load_policy("BicycleStab-v0"),
    }
    for side, result, ending, line in zip(("left", "right"), found["runs"], found["endings"], said, strict=True):
        driver, columns = drivers[chosen[side]], result["columns"]
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


def test_the_folder_is_written_and_not_over_others(files, tmp_path, monkeypatch):
    monkeypatch.setattr("bicycle_env.explore.page", lambda names: files)
    paths = explore.write(tmp_path)
    assert {path.name: path.read_bytes() for path in paths} == files
    assert sum(map(len, files.values())) < 1_000_000
    explore.write(tmp_path)
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(FileError, match=r"index.html: is there, and is not what `bicycle-env explore` has written"):
        explore.write(tmp_path)
