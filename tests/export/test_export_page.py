"""docs/export.md: its commands run, one after the other, and say what it says; its table is the code's."""

import re
import shlex
from pathlib import Path

import pytest
from building import GCC, NODE, run

from bicycle_env import tires
from bicycle_env.cli import main
from bicycle_env.export.plant import routines
from bicycle_env.physics.single_track import SingleTrack

PAGE = (Path(__file__).parents[2] / "docs" / "export.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.split("--out ")[1].split()[0])
def test_the_commands_run(block, tmp_path, monkeypatch, capsys):
    if "casadi" in block:
        pytest.importorskip("casadi")
    monkeypatch.chdir(tmp_path)
    folder, said = tmp_path, ""
    for line in block.splitlines():
        words = shlex.split(line)
        if words[0] == "bicycle-env":
            assert main(words[1:]) == 0
            assert capsys.readouterr().out
        elif words[0] == "cd":
            folder = tmp_path / words[1]
        elif (GCC if words[0] != "node" else NODE) is None:
            pytest.skip(f"what {words[0]} needs is not here")
        else:
            code, said = run(*words, folder=folder)
            assert code == 0, said
    assert not said or said.startswith(("0 of ", "the largest difference"))


@pytest.mark.skipif(NODE is None, reason="no node here")
def test_the_script_runs(tmp_path):
    (script,) = re.findall(r"```js\n(.*?)```", PAGE, re.DOTALL)
    main(["export", "--quiet", "--format", "js", "--out", str(tmp_path)])
    (tmp_path / "script.mjs").write_text(script)
    code, said = run(NODE, "script.mjs", folder=tmp_path)
    assert code == 0, said
    assert float(said) > 0.01


def test_the_lines_of_python_run(tmp_path, monkeypatch):
    (lines,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(lines, {})
    assert len(list(tmp_path.glob("*/bicycle_*"))) == 7


def test_the_operations_are_counted():
    rows = dict(re.findall(r"^\| (\w+) \| (\d+) \|$", PAGE, re.MULTILINE))
    found = {name: str(routines(SingleTrack.of(name), False)[1].program().operations) for name in tires.LAWS}
    assert rows == found


def test_the_functions_are_named():
    plant = set(re.findall(r"^\| `bicycle_plant_(\w+)` ", PAGE, re.MULTILINE))
    assert plant == {"substep", "control_step", "limited", "axles", "settled"}
