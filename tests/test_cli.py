"""The command bicycle-env: what it prints and writes, and one line with exit code 2 for every mistake."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import subprocess
import sys

import pytest

from bicycle_env import Vehicle, __version__, leaderboard, report, vehicles
from bicycle_env.cli import main
from bicycle_env.report import pictures

COARSE = ("--grid", "31")
LEVELS = ("easy", "medium", "hard")


def run(*words, **keywords):
    """The command as a process."""
    return subprocess.run(
        [sys.executable, "-m", "bicycle_env", *words], capture_output=True, text=True, check=False, **keywords
    )


@pytest.fixture
def no_matplotlib(monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] in ("matplotlib", "control")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "control", None)


def test_vehicles_lists_every_preset_with_its_source(capsys, no_matplotlib):
    assert main(["vehicles"]) == 0
    printed = capsys.readouterr().out
    lines = printed.splitlines()
    assert lines[0].split()[:3] == ["name", "mass", "wheelbase"]
    table = {line.split()[0]: line.split() for line in lines[2:] if line and line.split()[0] in vehicles}
    assert table["oversteer"] == ["oversteer", "1500", "2.70", "oversteer", "-1.17", "36.1", "none"]
    assert table["civic"] == ["civic", "1450", "2.62", "understeer", "+5.50", "none", "16.4"]
    flat = " ".join(printed.split())
    for name, car in vehicles.items():
        assert f"{name}: {car.source}" in flat


def test_vehicles_for_machines(capsys, no_matplotlib):
    assert main(["vehicles", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert list(content) == list(vehicles)
    for name, car in vehicles.items():
        assert content[name]["mass"] == car.mass
        assert (content[name]["critical_speed"] is None) == (name not in ("oversteer", "me303"))


@pytest.mark.exhaustive
def test_json_is_the_study(capsys, no_matplotlib):
    assert main(["report", "--vehicle", "civic", "--speed", "25", "--friction", "0.5", "--json", *COARSE]) == 0
    printed = capsys.readouterr()
    expected = report.as_json(report.study("civic", 25.0, friction=0.5, grid=31))
    assert json.loads(printed.out) == json.loads(json.dumps(expected))
    assert printed.err.startswith("computing what can be saved, on 31 x 31 states\n")


def test_tables_without_a_folder(capsys, no_matplotlib):
    assert main(["report", "--speed-ratio", "1.2", "--quiet", *COARSE]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("oversteer at 43.3 m/s = 156 km/h = 1.2 x the critical speed\n")
    assert "critical speed" in printed.out
    assert "36.06 m/s (130 km/h)" in printed.out
    assert "(6.17)" in printed.out
    assert printed.err == ""


@pytest.mark.exhaustive
def test_a_report_of_ones_own_car(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(pictures, "SUBJECTS", pictures.SUBJECTS[:1])
    mine = tmp_path / "my_car.json"
    mine.write_text(
        json.dumps({**dataclasses.asdict(vehicles["tsx"]), "source": "me & <mine>", "name": "mine<b>"}),
        encoding="utf-8",
    )
    out = tmp_path / "out"
    assert main(["report", "--vehicle", str(mine), "--speed", "40", "--json", "--out", str(out), *COARSE]) == 0
    printed = capsys.readouterr()
    content = json.loads(printed.out)  # nothing but JSON on standard output
    assert content["vehicle"]["name"] == "mine<b>"
    assert printed.err.splitlines()[-1] == str(out / "report.html")
    assert "drawing root_locus.png" in printed.err
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "mine&lt;b&gt; at 40.0 m/s = 144 km/h" in page
    assert "me &amp; &lt;mine&gt;" in page


def test_without_a_command_it_teaches(capsys):
    assert main([]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in ("report", "play", "explore", "COMMAND --help"))


def test_it_completes_in_shells(capsys, monkeypatch):
    assert main(["--completion", "bash"]) == 0
    assert "--speed-ratio" in capsys.readouterr().out
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["--completion", "bash"]) == 2
    assert "--completion needs shtab: pip install" in capsys.readouterr().err


def mistakes(tmp_path):
    (tmp_path / "file").write_text("")
    bad = tmp_path / "bad.toml"
    bad.write_text("mas = 3")
    return [
        (["--completion", "fish"], "argument --completion: invalid choice: 'fish'"),
        (["repor"], "invalid choice: 'repor'"),
        (["report", "--vehicle", "civi"], "did you mean 'civic'?"),
        (["report", "--vehicle", "civic", "--speed-ratio", "1.2"], "no critical speed; give speed in m/s"),
        (["report", "--vehicle", "nowhere.toml"], "nowhere.toml: No such file or directory"),
        (["report", "--vehicle", str(bad)], "unknown field of vehicle 'mas'; did you mean 'mass'?"),
        (["report", "--speed", "fast"], "argument --speed: invalid float value: 'fast'"),
        (["report", "--speed", "-3"], "speed must be a finite number in [0.1, 150], got -3.0"),
        (["report", "--speed", "nan"], "speed must be a finite number in [0.1, 150], got nan"),
        (["report", "--speed", "30", "--speed-ratio", "2"], "not allowed with argument --speed"),
        (["report", "--tire", "fila"], "did you mean 'fiala'?"),
        (["report", "--friction", "0"], "friction must be a finite number in"),
        (["report", "--grid", "5"], "grid must be a whole number in [31, 1001], got 5"),
        (["report", "--frictio", "1"], "unrecognized arguments: --frictio 1"),
        (["report", "--out", str(tmp_path / "file")], "file: Not a directory"),
        (["report", "--out", str(tmp_path / "file" / "folder")], "Not a directory"),
        (["vehicles", "civic"], "unrecognized arguments: civic"),
    ]


def test_every_mistake_is_one_line_and_exit_code_2(tmp_path, capsys):
    for words, text in mistakes(tmp_path):
        assert main(words) == 2, words
        printed = capsys.readouterr()
        assert printed.out == ""
        assert text in printed.err, words
        assert printed.err.startswith("bicycle-env: error: ")
        assert printed.err.count("\n") == 1, words


def test_a_likely_wrong_unit_is_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(report, "compute", lambda *_: None)
    monkeypatch.setattr(report, "as_text", lambda _: "numbers\n")
    (tmp_path / "my_car.json").write_text(
        json.dumps({**dataclasses.asdict(vehicles["tsx"]), "front_cornering_stiffness": 1446.3}), encoding="utf-8"
    )
    assert main(["report", "--vehicle", str(tmp_path / "my_car.json"), "--quiet"]) == 0
    printed = capsys.readouterr()
    assert printed.out == "numbers\n"
    assert printed.err.startswith("bicycle-env: remark: front_cornering_stiffness = 1446.3 N/rad is 0.149 per rad")
    assert printed.err.count("\n") == 1


def test_without_matplotlib_the_page_names_what_to_install_at_once(tmp_path, capsys, no_matplotlib):
    assert main(["report", "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == (
        'bicycle-env: error: a figure needs matplotlib: pip install -c constraints.txt -e ".[analysis]"\n'
    )
    assert not (tmp_path / "out").exists()


def test_the_command_as_a_process(tmp_path):
    done = run("report", "--vehicle", "overster", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        (["--version"], [f"bicycle-env {__version__}"]),
        (["--help"], ["report", "vehicles"]),
        (
            ["report", "--help"],
            ["examples:", "report --vehicle civic", "my_car.toml", "mass = 1500.0", "null", "--speed-ratio"],
        ),
        (["vehicles", "--help"], ["--json"]),
    ],
)
def test_help_teaches(words, shown, capsys):
    with pytest.raises(SystemExit) as left:
        main(words)
    assert left.value.code == 0
    printed = capsys.readouterr().out
    for word in shown:
        assert word in printed


def test_the_example_in_the_help_is_a_car(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["report", "--help"])
    lines = capsys.readouterr().out.splitlines()
    begin = next(k for k, line in enumerate(lines) if line.startswith("a car of one's own"))
    example = "\n".join(lines[begin + 1 : lines.index("", begin)])
    (tmp_path / "my_car.toml").write_text(example, encoding="utf-8")
    assert Vehicle.read(tmp_path / "my_car.toml").mass == 1500.0


def test_the_leaderboard(capsys, no_matplotlib):
    assert main(["leaderboard"]) == 0
    printed = capsys.readouterr().out
    assert all(f"{env_id}-v0 {level}\n" in printed for env_id in ("BicycleStab", "BicycleEvade") for level in LEVELS)
    assert main(["leaderboard", "--env-id", "BicycleStab-v0"]) == 0
    printed = capsys.readouterr().out
    assert "BicycleEvade" not in printed
    (row,) = [line for line in printed.splitlines() if line.split()[:1] == ["pretrained"] and " 2000 " in line][:1]
    assert re.fullmatch(r"  pretrained +\d+\.\d \[\d.*\] +\d+\.\d \[.*\] +\S+ +2000 +trained", row)
    assert main(["leaderboard", "--env-id", "BicycleStab-v0", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert set(content["levels"]) == {f"BicycleStab-v0 {level}" for level in LEVELS}
    assert content["command"].startswith("python -m agents.publishing")


def test_a_mistake_about_the_leaderboard_is_one_line(capsys, monkeypatch, tmp_path):
    assert main(["leaderboard", "--env-id", "BicycleStap-v0"]) == 2
    assert "env_id must be one of" in (line := capsys.readouterr().err)
    assert "did you mean 'BicycleStab-v0'?" in line
    (tmp_path / "leaderboard.json").write_text('{"levels": {"a b": {"rows": [{}]}}}')
    monkeypatch.setattr(leaderboard.read, "__defaults__", (tmp_path / "leaderboard.json",))
    assert main(["leaderboard"]) == 2
    assert "leaderboard.json: levels.a b.rows[0] must have the keys name, kind" in capsys.readouterr().err


def test_a_reader_that_stops_early_is_no_error():
    process = subprocess.Popen(
        [sys.executable, "-m", "bicycle_env", "vehicles", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    process.stdout.close()
    errors = process.stderr.read()
    process.stderr.close()
    process.wait()
    assert errors == b""
