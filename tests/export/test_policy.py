"""Policies in C and JavaScript act as in Python, to single precision; what they remember, too."""

import itertools
import re

import gymnasium as gym
import numpy as np
import pytest
from building import c_test, js_test, needs_gcc, needs_node

from bicycle_env import export
from bicycle_env.control import LQR, MPC, PolePlacement
from bicycle_env.control.network import Network
from bicycle_env.control.pretrained import load_policy

NAME = "bicycle_policy"


def network(**acts):
    """Small, with all that a network may do."""
    draws = np.random.default_rng(2)
    names = ["a", "b", "c"]
    width = len(names) * acts.get("history", 1)
    sizes = [width, 16, 2]
    layers = [
        (draws.standard_normal((wide, narrow)).astype(np.float32), draws.standard_normal(wide).astype(np.float32))
        for narrow, wide in itertools.pairwise(sizes)
    ]
    activation, output = acts.pop("activation", "tanh"), acts.pop("output", "tanh")
    return Network(layers, activation, output, {"observation_names": names, **acts})


@pytest.fixture(scope="module")
def env():
    return gym.make("BicycleStab-v0").unwrapped


POLICIES = {
    "pretrained": lambda env: load_policy("BicycleStab-v0"),
    "lqr": LQR,
    "pole-placement": PolePlacement,
    "plain": lambda env: network(activation="relu", output="clip"),
    "all": lambda env: network(hold=3, history=4, mirror=[1, -1, -1]),
}


def largest(said):
    return float(re.fullmatch(r"the largest difference of 120 actions to Python's: (\S+)\n", said)[1])


@needs_gcc
@pytest.mark.parametrize("name", POLICIES)
def test_c_acts_as_python(name, env, tmp_path):
    export.export_policy(POLICIES[name](env), "c", tmp_path, observation_names=env.observation_names)
    code, said = c_test(tmp_path, NAME)
    assert code == 0, said
    assert largest(said) < 2e-5
    source = (tmp_path / f"{NAME}.c").read_text()
    assert "double" not in source
    assert "malloc" not in source
    assert not re.search(r"\b(tanhf?|expf?|sinf?)\(", source)


@needs_node
@pytest.mark.parametrize("name", POLICIES)
def test_javascript_acts_as_python(name, env, tmp_path):
    export.export_policy(POLICIES[name](env), "js", tmp_path, observation_names=env.observation_names)
    code, said = js_test(tmp_path, NAME)
    assert code == 0, said
    assert largest(said) < 2e-5


@needs_gcc
@pytest.mark.parametrize(
    ("right", "wrong"),
    [("% 3;", "% 2;"), ("0.5f * (", "0.4f * ("), ("memory->started ?", "!memory->started ?"), ("20.0f", "0.5f")],
    ids=["hold", "mirror", "start", "tanh"],
)
def test_a_wrong_line_is_seen(right, wrong, tmp_path):
    export.export_policy(network(hold=3, history=4, mirror=[1, -1, -1]), "c", tmp_path)
    source = (tmp_path / f"{NAME}.c").read_text()
    assert right in source
    (tmp_path / f"{NAME}.c").write_text(source.replace(right, wrong))
    code, said = c_test(tmp_path, NAME)
    assert code == 1
    assert largest(said) > 1e-3


def test_another_controller_is_refused_in_words(env, tmp_path):
    with pytest.raises(ValueError, match="policy 'mpc' cannot be written out: only networks"):
        export.export_policy(MPC(env), "c", tmp_path)
