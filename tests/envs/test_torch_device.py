"""The torch environment on its device: nothing waits for the host, gradients flow, the compiler agrees."""

import itertools
import shutil
import subprocess
import sys

import numpy as np
import pytest
import torch
from combinations import only_all, pairwise
from torch._subclasses.fake_tensor import DataDependentOutputException, FakeTensorMode
from torch_cases import (
    CARS,
    IDS,
    LANE,
    MODES,
    STAB,
    STILL,
    assert_near,
    known,
    quick,
    random_actions,
    random_states,
    zeros,
)

from bicycle_env import Actuator, tires
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.physics.lateral import GEOMETRIES

# On the device, without waiting for it


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", IDS)
def test_a_step_reads_nothing_on_the_host(env_id, mode):
    """Fake tensors have no values: whatever asks for one raises."""
    envs = quick(env_id=env_id, autoreset_mode=mode, on_invalid="terminate", telemetry=True)
    envs.reset(seed=0)
    with FakeTensorMode(allow_non_fake_inputs=True):
        observation, reward, *_ = envs.step(zeros(envs))
        envs.reset()
    assert (observation.shape, reward.shape) == (envs.observation_space.shape, (4,))


def test_the_test_above_can_fail():
    envs = quick(on_invalid="raise")
    envs.reset(seed=0)
    with pytest.raises(DataDependentOutputException), FakeTensorMode(allow_non_fake_inputs=True):
        envs.step(zeros(envs))


class HostGenerator(torch.Generator):
    """torch makes no generator of a device that it does not have."""

    def __new__(cls, device=None):
        return super().__new__(cls)


@pytest.mark.parametrize(
    ("env_id", "mode", "tire"),
    [
        (STAB, "SameStep", "fiala"),
        (LANE, "NextStep", "linear"),
        only_all(LANE, "SameStep", "linear"),
        only_all(STAB, "Disabled", "tanh"),
    ],
)
def test_all_is_on_the_device(env_id, mode, tire, monkeypatch):
    """Fake CUDA tensors refuse to meet one on the host, and need no GPU."""
    monkeypatch.setattr(torch, "Generator", HostGenerator)
    with FakeTensorMode(allow_non_fake_inputs=True):
        given = {"autoreset_mode": mode, "on_invalid": "terminate", "telemetry": True, "tire": tire}
        given["physics_timestep"] = 0.02  # one substep
        envs = TorchVectorEnv(env_id, 4, device="cuda", friction=[1.0, 0.5, 1.0, 1.0], **given)
        assert str(envs.device) == "cuda:0"
        observation, info = envs.reset(seed=0, options={"state": {"yaw_rate": 0.1}})
        results = envs.step(torch.zeros(4, 2, device="cuda"))
        everything = [observation, *info.values(), *results[:4], *results[4].values(), *envs.state]
        everything += envs.measure().values()
        tensors = [one for value in everything for one in (value.values() if isinstance(value, dict) else [value])]
        assert {str(tensor.device) for tensor in tensors} == {"cuda:0"}
        with pytest.raises(ValueError, match="actions must be on cuda:0, got some on cpu"):
            envs.step(torch.zeros(4, 2))


# On a GPU, where there is one

gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")


@gpu
@pytest.mark.parametrize(
    ("env_id", "tire", "geometry", "reward"), pairwise(IDS, tires.LAWS, GEOMETRIES, ["default", "quadratic"])
)
def test_a_gpu_drives_the_same(env_id, tire, geometry, reward):
    """Five steps from states up to those that end an episode, the gradient of all rewards included."""
    cars = {"tire": tire, "geometry": geometry, "reward": reward, "friction": np.linspace(0.4, 1.0, CARS)}
    route = known(env_id, direction="left", change_start=0.5)
    seen = {}
    for device in ("cpu", "cuda"):
        envs = TorchVectorEnv(env_id, CARS, device=device, autoreset_mode="Disabled", **cars)
        envs.reset(options={"state": random_states(), **route})
        actions = torch.from_numpy(random_actions()).double().to(device).requires_grad_()
        steps = [envs.step(actions) for _ in range(5)]
        rewards = torch.stack([step[1] for step in steps])
        (slope,) = torch.autograd.grad(rewards.sum(), actions)
        ends = torch.stack([step[4]["end"] for step in steps])
        seen[device] = [*(value.detach().cpu() for value in (*envs.state, rewards, slope)), ends.cpu()]
    for on_host, on_gpu in zip(seen["cpu"][:-1], seen["cuda"][:-1], strict=True):
        assert_near(on_gpu, on_host.numpy())
    assert torch.equal(seen["cpu"][-1], seen["cuda"][-1])
    assert (seen["cpu"][-1] > 0).any()


@gpu
@pytest.mark.filterwarnings("ignore")  # the compiler's own
@pytest.mark.parametrize("compile", [False, True])
@pytest.mark.parametrize("mode", MODES)
def test_a_gpu_is_not_waited_for(mode, compile):
    envs = TorchVectorEnv(STAB, 64, device="cuda", autoreset_mode=mode, on_invalid="terminate", compile=compile)
    envs.reset(seed=0)
    actions = torch.rand(64, 2, device="cuda")
    with torch.no_grad():
        envs.step(actions)
        torch.cuda.set_sync_debug_mode("error")
        try:
            envs.step(actions)
        finally:
            torch.cuda.set_sync_debug_mode("default")


@gpu
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("env_id", IDS)
def test_compiled_cars_on_a_gpu_drive_as_on_the_host(env_id):
    """The compiler may fuse what the source leaves open: near, not equal."""
    seen = {}
    for device, compile in (("cpu", False), ("cuda", True)):
        envs = TorchVectorEnv(env_id, CARS, device=device, autoreset_mode="Disabled", compile=compile)
        with torch.no_grad():
            envs.reset(options={"state": random_states(), **known(env_id, direction="left", change_start=0.0)})
            envs.set_state({"change_start": 0.5} if env_id == LANE else {})
            steps = [envs.step(torch.from_numpy(random_actions()).to(device)) for _ in range(3)]
        seen[device] = [torch.stack([step[place].cpu() for step in steps]) for place in (1, 2)]
    assert_near(seen["cuda"][0], seen["cpu"][0].numpy())
    assert torch.equal(seen["cuda"][1], seen["cpu"][1])


# Gradients


@pytest.mark.parametrize("reward", ["default", "quadratic"])
@pytest.mark.parametrize("env_id", IDS)
def test_the_reward_has_the_gradient_of_its_finite_differences(env_id, reward):
    """Through two steps, so through the state, too; small states, far from where clips and limits have corners."""
    states = {name: 0.05 * column[:2] for name, column in random_states().items()}
    states |= dict.fromkeys(("front_steer_command", "rear_steer_command"), 0.0)
    states |= known(env_id, direction=1.0, change_start=-20.0)
    few = {"physics_timestep": 0.01}  # two substeps: one after another
    envs = TorchVectorEnv(env_id, 2, reward=reward, rear_actuator=Actuator(angle_limit=0.05), **few)
    envs.reset(seed=0)

    def gained(actions):
        envs.set_state(states)
        return sum(envs.step(action)[1] for action in actions)  # of each car

    numbers = torch.rand(2, 2, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    actions = (0.1 * numbers).requires_grad_()
    (slope,) = torch.autograd.grad(gained(actions).sum(), actions)
    width = 1e-5
    with torch.no_grad():
        for step, axle in itertools.product(range(2), repeat=2):
            nudge = torch.zeros_like(actions)
            nudge[step, :, axle] = width
            measured = (gained(actions + nudge) - gained(actions - nudge)) / (2.0 * width)
            np.testing.assert_allclose(slope[step, :, axle], measured, rtol=1e-5, atol=1e-8)
    assert (slope[0].abs() > 1e-6).all()


def test_gradients_are_finite_from_any_state_and_stop_at_the_end_of_an_episode():
    envs = TorchVectorEnv(STAB, CARS, autoreset_mode="SameStep")
    envs.reset(seed=0)
    envs.set_state(random_states())
    actions = torch.from_numpy(random_actions()).requires_grad_()
    *_, info = envs.step(actions)
    over = info["_final_obs"]
    assert over.any()
    assert not over.all()
    observation, *_ = envs.step(zeros(envs))
    (slope,) = torch.autograd.grad(observation.sum(), actions)
    assert slope.isfinite().all()
    assert (slope[over] == 0.0).all()
    assert (slope[~over] != 0.0).any(), "elsewhere the actions count, unless they saturate"


def test_detach_forgets_how_the_state_came_about():
    envs = quick()
    envs.reset(seed=0)
    actions = zeros(envs).requires_grad_()
    observation, *_ = envs.step(actions)
    assert observation.requires_grad
    assert envs.step(zeros(envs))[0].requires_grad
    envs.detach()
    assert not envs.step(zeros(envs))[0].requires_grad


def test_given_states_may_require_gradients():
    envs = quick()
    envs.reset(seed=0)
    yaw_rate = torch.full((4,), 0.1, dtype=torch.float64, requires_grad=True)
    envs.set_state({**STILL, "yaw_rate": yaw_rate})
    (slope,) = torch.autograd.grad(envs.step(zeros(envs))[1].sum(), yaw_rate)
    assert (slope < 0.0).all(), "turning costs reward"


# The compiler


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")
@pytest.mark.filterwarnings("ignore")  # the compiler's own
@pytest.mark.parametrize("backend", [only_all("aot_eager"), only_all("inductor")])
def test_compiled_cars_drive_the_same_and_compile_once(backend, monkeypatch):
    """Captured whole, once; "aot_eager" leaves out the machine code of the default, which takes half a minute."""
    if backend != "inductor":
        compiler = torch.compile
        chosen = {"fullgraph": True, "dynamic": False}
        monkeypatch.setattr(torch, "compile", lambda law, **given: compiler(law, backend=backend, **chosen))
    plain, compiled = (quick(CARS, compile=compile, autoreset_mode="Disabled") for compile in (False, True))
    actions = torch.from_numpy(random_actions())
    with torch.no_grad():
        for envs in (plain, compiled):
            envs.reset(seed=0)
            envs.step(actions)
        with torch._dynamo.config.patch(error_on_recompile=True):
            for envs in (plain, compiled):
                envs.reset(options={"state": random_states()})
                envs.set_state({"heading": 0.1})
            results, expected = compiled.step(actions), plain.step(actions)
            other = quick(CARS, compile=True, autoreset_mode="Disabled", friction=0.9)
            other.reset(seed=0)
            other.step(actions)
    assert_near(results[1], expected[1].numpy())
    assert results[4]["end"].tolist() == expected[4]["end"].tolist()
    for column, other in zip(compiled.state, plain.state, strict=True):
        assert_near(column, other.numpy())


# Imports


def test_the_ids_module_and_torch_are_imported_when_they_are_used_and_torch_is_missed_in_one_line():
    program = (
        "import sys\n"
        "from bicycle_env.envs import TorchVectorEnv\n"
        "print('torch' in sys.modules)\n"
        "sys.modules['torch'] = None\n"
        "try:\n"
        "    TorchVectorEnv('BicycleStab-v0', 2)\n"
        "except ImportError as error:\n"
        "    print(error)\n"
        "del sys.modules['torch']\n"
        "print(TorchVectorEnv('bicycle_env:BicycleStab-v0', 2).spec.id)\n"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "False",
        'TorchVectorEnv needs torch: pip install -c constraints.txt -e ".[agents]"',
        STAB,
    ]
