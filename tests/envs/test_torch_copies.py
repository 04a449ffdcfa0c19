"""Copies of the torch environment, by deepcopy and pickle: they go on the same. Seeds of any size; reset masks."""

import copy
import pickle

import numpy as np
import pytest
import torch
from torch_cases import IDS, LANE, MODES, STAB, assert_same_bits, quick, zeros

from bicycle_env.envs import TorchVectorEnv
from bicycle_env.envs.tensors import torch_device

HOW = {"deepcopy": copy.deepcopy, "pickle": lambda envs: pickle.loads(pickle.dumps(envs))}


def driven(envs, steps=4):
    envs.reset(seed=3)
    for _ in range(steps):
        envs.step(zeros(envs) + 0.3)
    return envs


def future(envs, steps=12):
    """What comes after, with random starts on the way."""
    results = [envs.step(zeros(envs) - 0.4) for _ in range(steps)]
    return [results, envs.reset(), tuple(envs.state)]


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", IDS)
def test_a_copy_goes_on_the_same(env_id, mode, how):
    cars = {"friction": np.linspace(0.5, 1.0, 4), "telemetry": True}
    envs = driven(quick(env_id=env_id, autoreset_mode=mode, max_episode_steps=7, **cars))
    assert envs.observation_space is not None  # made when asked for, and copied then
    twin = HOW[how](envs)
    state = envs.state
    expected = future(envs)
    assert_same_bits(tuple(twin.state), tuple(state))
    assert_same_bits(future(twin), expected)
    assert twin.np_random_seed == envs.np_random_seed == 3


@pytest.mark.parametrize("how", HOW)
def test_a_copy_before_the_first_reset_draws_the_same_starts(how):
    envs = quick()
    assert_same_bits(HOW[how](envs).reset(), envs.reset())


def test_a_copy_compiles_for_itself(monkeypatch):
    """The compiler takes a minute: here it is one that compiles nothing, and counts."""
    compiled = []
    monkeypatch.setattr(torch_device, "_compiled", lambda torch, law: compiled.append(law) or law)
    envs = driven(quick(compile=True, max_episode_steps=7))
    number = len(compiled)
    for how in HOW.values():
        assert_same_bits(future(how(envs)), future(copy.deepcopy(envs)))
    assert number > 0
    assert len(compiled) == 5 * number


def test_a_copy_has_no_gradients_of_the_past():
    envs = quick()
    envs.reset(seed=0)
    action = torch.zeros(4, 2, requires_grad=True)
    envs.step(action)
    for how in HOW.values():
        twin = how(envs)
        assert not twin.state.yaw_rate.requires_grad
        assert_same_bits(twin.state.yaw_rate, envs.state.yaw_rate.detach())
        twin.step(action)[1].sum().backward()
    assert envs.state.yaw_rate.requires_grad


@pytest.mark.parametrize("seed", [2**63, 2**64 - 1, 2**64 + 5, 10**40])
def test_seeds_have_any_size(seed):
    envs, twin, other = quick(), quick(), quick()
    first = envs.reset(seed=seed)
    assert_same_bits(first, twin.reset(seed=seed))
    assert not torch.equal(first[0], other.reset(seed=seed + 1)[0])
    assert envs.np_random_seed == seed


@pytest.mark.parametrize("seed", [0, 7, 2**63 - 1])
def test_smaller_seeds_are_torchs_own(seed):
    envs = quick()
    envs.reset(seed=seed)
    assert envs._generator.initial_seed() == envs.np_random_seed == seed
    assert envs.np_random.random() == np.random.default_rng(seed).random()


def test_without_a_seed_there_is_one_from_the_beginning():
    envs = quick()
    seed = envs.np_random_seed
    first = envs.reset()
    assert envs.np_random_seed == seed
    assert_same_bits(first, quick().reset(seed=seed) if seed < 2**63 else first)


# What belongs to the caller


def test_a_mask_stays_the_callers_and_gradients_remember_their_own():
    envs = quick()
    envs.reset(seed=0)
    heading = torch.full((4,), 0.1, dtype=torch.float64, requires_grad=True)
    mask = torch.tensor([True, False, True, False])
    envs.reset(options={"reset_mask": mask, "state": {"heading": heading}})
    mask.fill_(False)
    envs.step(zeros(envs))[1].sum().backward()
    assert (heading.grad != 0.0).tolist() == [True, False, True, False]


# Options


def test_each_car_changes_to_its_own_side_at_its_own_time():
    envs, alike = quick(env_id=LANE), quick(env_id=LANE)
    sides, begins = ["left", "right", "right", "left"], torch.tensor([0.0, 0.5, 1.0, 100.0], dtype=torch.float64)
    envs.reset(seed=3, options={"direction": sides, "change_start": begins})
    assert envs.state.direction.tolist() == [1.0, -1.0, -1.0, 1.0]
    for row, (side, begin) in enumerate(zip(sides, begins.tolist(), strict=True)):
        alike.reset(seed=3, options={"direction": side, "change_start": begin})
        assert_same_bits([column[row] for column in envs.state], [column[row] for column in alike.state])
    before = envs.state
    mask = torch.tensor([True, False, True, False])
    envs.reset(options={"reset_mask": mask, "direction": np.array(sides[::-1]), "change_start": 2.0})
    assert envs.state.direction.tolist() == [1.0, -1.0, -1.0, 1.0]
    assert torch.equal(envs.state.change_start[~mask], before.change_start[~mask])
    assert len(envs.state.change_start[mask].unique()) == 1


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"direction": ["left"] * 3}, ValueError, "direction.*num_envs = 4 of them, got 3"),
        ({"direction": ["left"] * 3 + ["rigth"]}, ValueError, r"\[3\].*did you mean 'right'"),
        ({"direction": 0.5 * torch.ones(4)}, TypeError, "direction"),
        ({"change_start": torch.tensor([0.0, 0.0, 0.0, 100.5])}, ValueError, r"change_start.*\[0, 100\], got 100.5"),
        ({"change_start": [0.0, 1.0]}, ValueError, "change_start"),
    ],
)
def test_bad_routes_are_named_and_nothing_changes(options, error, match):
    envs, twin = driven(quick(env_id=LANE)), driven(quick(env_id=LANE))
    with pytest.raises(error, match=match):
        envs.reset(seed=8, options=options)
    assert_same_bits(future(envs), future(twin))


# Gradients


@pytest.mark.parametrize("name", ["friction", "speed", "speed_ratio"])
def test_a_keyword_that_requires_a_gradient_is_refused_in_words(name):
    with pytest.raises(ValueError, match=rf"{name} must not require a gradient.*give {name}.detach\(\)"):
        TorchVectorEnv(STAB, 4, **{name: torch.full((4,), 1.2, requires_grad=True)})


def test_one_number_for_all_keeps_its_gradient():
    envs = quick()
    heading = torch.tensor(0.1, dtype=torch.float64, requires_grad=True)
    envs.reset(seed=0, options={"state": {"heading": heading}})
    envs.step(zeros(envs))[1].sum().backward()
    assert heading.grad != 0.0


# Success


def test_a_car_that_is_put_somewhere_has_not_yet_settled_there():
    envs = quick(vehicle="understeer", speed=20.0)
    envs.reset(options={"state": {"yaw_rate": 0.0}})
    for _ in range(60):
        envs.step(zeros(envs))
    assert envs.is_success.all()
    _, info = envs.set_state({"lateral_position": 0.1})
    assert not info["is_success"].any()
    for _ in range(49):
        assert not envs.step(zeros(envs))[4]["is_success"].any()
    assert envs.step(zeros(envs))[4]["is_success"].all()
