"""``bicycle-env export``: its files, its one-line errors, and what it does not overwrite."""

import json

import gymnasium as gym
import pytest

from bicycle_env.cli import main
from bicycle_env.control import LQR
from bicycle_env.control.pretrained import place
from bicycle_env.export import export_policy
from bicycle_env.export.writing import write_folder
from bicycle_env.files import FileError

LINEAR = ("export", "--tire", "linear", "--format", "c")


def test_files_are_written_and_named(tmp_path, capsys):
    assert main([*LINEAR, "--out", str(tmp_path / "new" / "car")]) == 0
    printed = capsys.readouterr()
    names = ["bicycle_plant.h", "bicycle_plant.c", "bicycle_plant_test.c"]
    assert printed.out.splitlines() == [str(tmp_path / "new" / "car" / name) for name in names]
    assert printed.err == (
        "oversteer at 43.2729 m/s, 1.2 x the critical speed; the Linear tire, small_angle geometry; friction 1\n"
    )
    content = json.loads((tmp_path / "new" / "car" / "export.json").read_text())
    assert set(content["files"]) == set(names)
    assert content["format"] == "c"


def test_actuators_and_road_reach_the_source(tmp_path):
    words = ("--front-actuator", "angle_limit=0.5,rate_limit=inf", "--friction", "0.5", "--quiet")
    assert main([*LINEAR, *words, "--out", str(tmp_path)]) == 0
    source = (tmp_path / "bicycle_plant.c").read_text()
    assert ".front_angle_limit = 0.5, /* rad */" in source
    assert ".front_rate_limit = INFINITY, /* rad/s */" in source
    assert ".front_time_constant = 0.05, /* s */" in source


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--format", "rust"), "format must be"),
        (("--format", "js", "--fma"), "fma goes with the formats c and fmu"),
        (("--tire", "fila"), "did you mean 'fiala'?"),
        (("--vehicle", "civi"), "did you mean 'civic'?"),
        (("--geometry", "exac"), "did you mean 'exact'?"),
        (("--speed", "-3"), "speed must be"),
        (("--relaxation-length", "0"), "relaxation_length must be"),
        (("--physics-timestep", "0.2"), "physics_timestep must be <="),
        (("--front-actuator", "angle=0.5"), "unknown field of --front-actuator 'angle'"),
        (("--front-actuator", "angle_limit=wide"), "--front-actuator must be FIELD=NUMBER"),
        (("--front-actuator", "angle_limit=9"), "angle_limit must be"),
        (("--format", "casadi", "--fma"), "fma goes with the formats c and fmu"),
        (("--level", "hard"), "--level goes with --env-id"),
        (("--env-id", "BicycleStab-v0", "--level", "har"), "did you mean 'hard'?"),
        (("--env-id", "BicycleStap-v0"), "env_id: Environment `BicycleStap` doesn't exist. Did you mean"),
        (("--env-id", "CartPole-v1"), "env_id must be an environment of this package"),
        (("--env-id", "BicycleStab-v0", "--pushed"), "--pushed goes with a plant"),
        (("--env-id", "BicycleStab-v0", "--format", "casadi"), "format must be one of 'c', 'js'"),
        (("--policy", "pretrained"), "--tire has no meaning with --policy pretrained"),
        (("--policy", "nobody"), "policy must be one of"),
        (("--policy", "lqr", "--fma"), "--fma goes with a plant or a task"),
        (("--policy", "mpc"), "policy 'mpc' cannot be written out"),
    ],
)
def test_every_mistake_is_one_line(words, text, tmp_path, capsys):
    assert main([*LINEAR, *words, "--out", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr()
    assert text in printed.err
    assert printed.err.startswith("bicycle-env: error: ")
    assert printed.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--policy", "pretrained", "--env-id", "BicycleEvade-v0", "--level", "har"), "did you mean 'hard'"),
        (("--policy", "{tmp}"), "is not a policy folder"),
    ],
)
def test_a_policy_that_is_not_there_is_one_line(words, text, tmp_path, capsys):
    words = [word.format(tmp=tmp_path) for word in words]
    assert main(["export", "--format", "c", *words, "--out", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr().err
    assert text in printed
    assert printed.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("--policy", "pretrained"), "bicycle_policy.c"),
        (("--policy", str(place("BicycleStab-v0", "medium"))), "bicycle_policy.c"),
        (("--policy", "lqr"), "bicycle_policy.c"),
        (("--env-id", "BicycleStab-v0", "--level", "hard", "--fma"), "bicycle_task.c"),
    ],
)
def test_policies_and_tasks(words, name, tmp_path, capsys):
    assert main(["export", *words, "--format", "c", "--out", str(tmp_path)]) == 0
    assert str(tmp_path / name) in capsys.readouterr().out.splitlines()


def test_a_matrix_is_designed_as_for_the_environment(tmp_path):
    """Without its compiled code, and for the same car."""
    assert main(["export", "--policy", "lqr", "--speed-ratio", "1.4", "--format", "js", "--out", str(tmp_path)]) == 0
    env = gym.make("BicycleStab-v0", speed_ratio=1.4)
    export_policy(LQR(env.unwrapped), "js", tmp_path / "env", observation_names=env.unwrapped.observation_names)
    name = "bicycle_policy.mjs"
    assert (tmp_path / name).read_text() == (tmp_path / "env" / name).read_text()


def test_what_somebody_else_wrote_is_kept(tmp_path, capsys):
    (tmp_path / "bicycle_plant.c").write_text("mine")
    assert main([*LINEAR, "--quiet", "--out", str(tmp_path)]) == 2
    assert "is not what `bicycle-env export` has written" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["bicycle_plant.c"]
    assert (tmp_path / "bicycle_plant.c").read_text() == "mine"


def test_an_export_replaces_an_earlier_one_but_no_edit(tmp_path):
    write_folder(tmp_path, {"a": "1", "b": "1"}, {})
    write_folder(tmp_path, {"a": "2"}, {})
    write_folder(tmp_path, {"a": "3", "b": "3"}, {})
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text() == "3"
    (tmp_path / "b").write_text("edited")
    with pytest.raises(FileError, match="b: is there"):
        write_folder(tmp_path, {"a": "4", "b": "4"}, {})
    assert (tmp_path / "a").read_text() == "3"


def test_after_a_kill_in_between_the_next_export_goes_on(tmp_path, monkeypatch):
    from bicycle_env.export import writing

    write_folder(tmp_path, {"a": "1", "b": "1"}, {})
    real = writing.write_bytes

    def killed(path, content):
        if path.name == "b":
            raise KeyboardInterrupt
        real(path, content)

    monkeypatch.setattr(writing, "write_bytes", killed)
    with pytest.raises(KeyboardInterrupt):
        write_folder(tmp_path, {"a": "2", "b": "2"}, {})
    monkeypatch.undo()
    assert write_folder(tmp_path, {"a": "3", "b": "3"}, {}) == [tmp_path / "a", tmp_path / "b"]


def test_another_list_of_that_name_is_kept(tmp_path):
    (tmp_path / "export.json").write_text('{"written_by": "me", "files": {}}')
    with pytest.raises(FileError, match=r"export\.json: is there"):
        write_folder(tmp_path, {"a": "1"}, {})
