"""Who steers, what acts on the car, what an episode remembers: a task of one's own, alike in every environment."""

import dataclasses
from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all
from gymnasium.envs.registration import registry

import bicycle_env
from bicycle_env import analysis, tires, vehicles
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarParameters, CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.records import replaced
from bicycle_env.physics.single_track import SingleTrack
from bicycle_env.tasks.checking import check
from bicycle_env.tasks.control_step import transition
from bicycle_env.tasks.episode import EpisodeState, Rules, World
from bicycle_env.tasks.rewards import Reward
from bicycle_env.tasks.stabilise import Nothing, Stabilise
from bicycle_env.tasks.task import Entry

ID = "Test/Doors-v0"
STEPS, CARS = 60, 8


class Gusts(NamedTuple):
    """Drawn: when the gust begins and from where; remembered: the largest yaw rate."""

    gust_start: Any
    gust_side: Any
    largest_yaw_rate: Any


@dataclasses.dataclass(frozen=True)
class Doors(Stabilise):
    """A driver holds the front wheels, a policy the rear ones; a gust of half a second; ice from 20 m on."""

    TaskState, uniforms, flipped = Gusts, 6, ("gust_side",)
    ends: ClassVar = ("spun", "left_lane", "turned")
    gust_force: float = 2000.0
    gust_arm: float = 0.5
    amplitude: float = 0.02
    most_heading: float = 0.6

    def start(self, xp):
        inner = xp.function(Stabilise.start(self, xp))

        def start(uniforms, world):
            state, _ = inner(uniforms, world)
            side = xp.where(uniforms[5] < 0.5, -1.0 + 0.0 * state.heading, 1.0)
            return state, Gusts(0.1 + 0.4 * uniforms[4], side, 0.0 * state.heading)

        return start

    def command(self, xp):
        amplitude = self.amplitude

        def command(state, episode, action, world):
            time = episode.steps * world.rules.control_timestep
            driver = amplitude * episode.task_state.gust_side * xp.sin(3.0 * time)
            return driver + 0.0 * action[0], action[1] * world.car.rear_angle_limit

        return command

    def conditions(self, xp):
        force, arm = self.gust_force, self.gust_arm
        names = ("side_force", "yaw_moment", "front_peak_force", "rear_peak_force")
        changed = xp.function(replaced(xp, CarParameters, names))

        def conditions(state, episode, time, world):
            own, car = episode.task_state, world.car
            blowing = (time >= own.gust_start) & (time < own.gust_start + 0.5)
            push = xp.where(blowing, force * own.gust_side, 0.0)
            grip = xp.where(state.longitudinal_position > 20.0, 0.45 + 0.0 * push, 1.0)
            return changed(car, push, arm * push, grip * car.front_peak_force, grip * car.rear_peak_force)

        return conditions

    def remember(self, xp):
        def remember(state, episode, action, world):
            own = episode.task_state
            return Gusts(own.gust_start, own.gust_side, xp.maximum(own.largest_yaw_rate, abs(state.yaw_rate)))

        return remember

    def end(self, xp):
        usual, most = xp.function(Stabilise.end(self, xp)), self.most_heading

        def end(state, reference, episode, world):
            return xp.where(abs(state.heading) > most, 4, usual(state, reference, episode, world))

        return end

    def cost(self, xp):
        return lambda state, reference, episode, world: xp.where(abs(state.yaw_rate) > 0.3, 1.0, 0.0 * state.heading)

    def success(self, xp):
        return lambda state, reference, episode, world: abs(state.lateral_velocity) < 5.0

    def observe(self, xp):
        inner = xp.function(Stabilise.observe(self, xp))

        def observe(state, episode, world):
            seen, more = inner(state, episode, world), (episode.task_state.largest_yaw_rate,)
            return seen + more

        return observe

    def entries(self, speed, front_limit, rear_limit):
        given = Stabilise.entries(self, speed, front_limit, rear_limit)
        return (*given, Entry("largest_yaw_rate", "rad/s", 1.0, 10.0, "so far", 1.0))


@dataclasses.dataclass(frozen=True)
class Held(Reward):
    """Less for a fast steer now, and for a large heading before; a failure pays for each step that is done."""

    weight: float = 2.0

    def before(self, xp):
        return lambda state, reference, action, world: abs(state.heading)

    def law(self, xp):
        weight = self.weight

        def law(state, reference, action, memory, before, end, world):
            change = action[1] - memory.rear_steer_command / world.car.rear_angle_limit
            return -weight * change * change - before

        return law

    def forfeit(self, xp, task):
        fine = task.limits.yaw_rate
        return lambda steps, car, rules: -fine * steps


@pytest.fixture(scope="module", autouse=True)
def registered():
    bicycle_env.register(ID, Doors(), 50)
    yield
    registry.pop(ID)


KIND = {"tire": "linear", "geometry": "small_angle", "reward": Held()}


def actions():
    rng = np.random.default_rng(5)
    return np.clip(np.cumsum(rng.uniform(-0.3, 0.3, (STEPS, CARS, 2)), axis=0), -1.0, 1.0).astype(np.float32)


@pytest.mark.parametrize(("tire", "varied"), [("linear", False), only_all("tanh", True)])
def test_one_car_is_one_of_many_and_tensors_agree(tire, varied):
    """With laws of its own for all that the others in this folder ask without the compiler, a reward included."""
    kind = {**KIND, "tire": tire}
    given = {**kind, "autoreset_mode": "Disabled"}
    friction = np.linspace(0.5, 1.0, CARS) if varied else np.ones(CARS)
    own = {"friction": friction} if varied else {}
    many = gym.make_vec(ID, CARS, **given, **own)
    tensors = TorchVectorEnv(ID, CARS, **given, **own)
    alone = [gym.make(ID, **kind, friction=friction[k], telemetry=True) for k in range(CARS)]
    many.reset(seed=1)
    for k, env in enumerate(alone):
        env.reset(seed=1 + k)
    tensors.reset(seed=0)
    state = many.unwrapped.state._asdict()
    tensors.set_state({name: torch.from_numpy(value) for name, value in state.items()})
    over = np.zeros(CARS, bool)
    forces, words, costs = set(), set(), set()
    for action in actions():
        observation, reward, terminated, truncated, info = many.step(action)
        seen, gained, *_, told = tensors.step(torch.from_numpy(action))
        of_many, of_tensors = many.unwrapped.measure(), tensors.measure()
        for k, env in enumerate(alone):
            if not over[k]:
                expected = env.step(action[k])
                assert (observation[k].tobytes(), reward[k]) == (expected[0].tobytes(), expected[1]), k
                assert (terminated[k], truncated[k]) == expected[2:4]
                assert many.unwrapped.end_names[info["end"][k]] == expected[4]["end"]
                for name in ("cost", "is_success"):
                    assert info[name][k] == expected[4][name] == told[name][k].item()
                words.add(expected[4]["end"])
                costs.add(expected[4]["cost"])
                assert gained[k].item() == pytest.approx(reward[k], rel=1e-12, abs=1e-12)
                np.testing.assert_allclose(seen[k].numpy(), observation[k], rtol=1e-6, atol=1e-7)
                measured = env.unwrapped.measure()
                forces.add(measured["front_peak_force"])
                assert {name: values[k] for name, values in of_many.items()} == measured
                assert {name: values[k].item() for name, values in of_tensors.items()} == pytest.approx(measured)
        over |= terminated | truncated
    assert over.all()
    assert {"", "turned"} <= words
    assert costs == {0.0, 1.0}
    assert len(forces) == 2 * len(set(friction)), "on the road and on the ice"


@pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
def test_a_gust_turns_the_car_as_the_linear_model_says():
    """m V' = ... + F, Iz r' = ... + F arm, without steering: the state after 0.2 s, against the matrix exponential."""
    import scipy.linalg

    still = Doors(gust_force=1000.0, gust_arm=0.8, amplitude=0.0)
    bicycle_env.register("Test/Still-v0", still, 50)
    env = gym.make("Test/Still-v0", tire="linear", geometry="small_angle", physics_timestep=0.001).unwrapped
    env.reset(seed=3, options={"state": {}})
    env.unwrapped._rows.put({"gust_start": 0.1, "gust_side": 1.0}, np.ones(1, bool))
    for _ in range(15):
        env.step(np.zeros(2, np.float32))
    car = vehicles["oversteer"]
    A = analysis.state_matrix(car, env.speed)
    push = np.array([1000.0 / car.mass, 1000.0 * 0.8 / car.yaw_inertia])
    system = np.zeros((3, 3))
    system[:2, :2], system[:2, 2] = A, push
    expected = scipy.linalg.expm(system * 0.2)[:2, 2]
    assert (env.state.lateral_velocity, env.state.yaw_rate) == pytest.approx(tuple(expected), rel=1e-6)
    registry.pop("Test/Still-v0")


def test_the_driver_steers_the_front_wheels_and_the_policy_the_rear_ones():
    env = gym.make(ID, **KIND).unwrapped
    env.reset(seed=0, options={"state": {}})
    side = env.state.gust_side
    for k in range(5):
        env.step(np.array([1.0, 0.5], np.float32))
        assert env.state.front_steer_command == pytest.approx(0.02 * side * np.sin(3.0 * 0.02 * k), abs=1e-12)
        assert env.state.rear_steer_command == 0.5 * env.rear_actuator.angle_limit


def test_what_is_remembered_ends_with_the_episode_and_is_in_snapshots():
    env = gym.make(ID, **KIND).unwrapped
    env.reset(seed=0)
    seen = []
    for action in actions()[:20, 0]:
        env.step(action)
        seen.append(abs(env.state.yaw_rate))
        assert env.state.largest_yaw_rate == max(seen)
    kept = env.snapshot()
    env.reset()
    assert env.state.largest_yaw_rate == 0.0
    env.restore(kept)
    assert env.state.largest_yaw_rate == max(seen)


def variant(**laws):
    return dataclasses.dataclass(frozen=True)(type("Variant", (Doors,), laws))()


@pytest.mark.parametrize(
    ("laws", "match"),
    [
        ({"command": lambda self, xp: lambda *_: 0.1}, r"'command' must give one finite number per car, got 0\.1"),
        ({"command": lambda self, xp: lambda s, e, a, w: (a[0], a[1], a[1])}, r"'command' must return \(front, rear\)"),
        (
            {"command": lambda self, xp: lambda s, e, a, w: (0.1 + a[0], a[1])},
            "'command' is another one for the mirror",
        ),
        ({"conditions": lambda self, xp: lambda s, e, t, w: w}, "'conditions' must be a CarParameters, got World"),
        ({"remember": lambda self, xp: lambda s, e, a, w: (0.0,) * 3}, "'remember' must be a Gusts, got tuple"),
        ({"remember": lambda self, xp: lambda s, e, a, w: Gusts(s.yawrate, 0.0, 0.0)}, "'remember' fails .*yawrate"),
        ({"flipped": ()}, "'command' is another one for the mirror image"),
    ],
)
def test_a_law_that_cannot_be_is_refused_in_one_line(laws, match):
    with pytest.raises((TypeError, ValueError), match=match) as error:
        check(variant(**laws))
    assert "\n" not in str(error.value)


@dataclasses.dataclass(frozen=True)
class Slippery(Stabilise):
    """From 10 m on the road has no grip at all, and with `soft` the tires no stiffness either."""

    soft: bool = False

    def conditions(self, xp):
        names = ("front_peak_force", "rear_peak_force")
        if self.soft:
            names = (*names, "front_cornering_stiffness", "rear_cornering_stiffness")
        changed, soft = replaced(xp, CarParameters, names), self.soft

        def conditions(state, episode, time, world):
            car, left = world.car, xp.where(state.longitudinal_position > 10.0, 0.0, 1.0 + 0.0 * time)
            peaks = (left * car.front_peak_force, left * car.rear_peak_force)
            if soft:
                return changed(car, *peaks, left * car.front_cornering_stiffness, left * car.rear_cornering_stiffness)
            return changed(car, *peaks)

        return conditions


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("tire", [name for name in tires.LAWS if name != "linear"])
def test_a_road_without_grip_lets_the_car_slide_on(tire, soft):
    """The laws divide by the peak force: the state was NaN, and the episode ran on."""
    task, model = Slippery(soft), SingleTrack.of(tire)
    check(task)
    rules = Rules(0.02, 5, 400, 1.0, 1.0)
    world = World(car_on_road(vehicles["oversteer"], 40.0, 1.0, FRONT, REAR), rules, task.settings(40.0))
    step = transition(NUMPY, task, model, task.rewards["default"])
    zero = np.zeros(2)
    state = CarState(zero + 9.0, zero, zero, np.array([1.0, -2.0]), np.array([0.2, 0.3]), zero, zero)
    episode, rates = EpisodeState(zero, zero, zero, zero, Nothing()), []
    for _ in range(20):
        state, episode, *_ = step(state, episode, (0.3 + zero, -0.2 + zero), world, 5)
        rates.append(state.yaw_rate)
    assert np.all(np.isfinite(state))
    np.testing.assert_array_equal(rates[2], rates[-1])  # nothing turns it any more
    assert np.all(rates[0] != rates[2])


@pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
def test_telemetry_of_a_car_without_grip():
    bicycle_env.register("Test/Slippery-v0", Slippery)
    env = gym.make("Test/Slippery-v0", telemetry=True)
    env.reset(seed=0, options={"state": {"longitudinal_position": 20.0, "yaw_rate": 0.4}})
    info = env.step(np.zeros(2, np.float32))[4]
    registry.pop("Test/Slippery-v0")
    assert np.isfinite([value for name, value in info.items() if name != "end"]).all()
    assert abs(info["front_lateral_force"]) < 1e-9


@pytest.mark.parametrize(
    ("field", "factor", "words"), [("mass", 0.0, "mass > 0, got"), ("rear_peak_force", -1.0, "rear_peak_force >= 0")]
)
def test_a_car_that_cannot_be_is_refused(field, factor, words):
    def conditions(self, xp):
        changed = replaced(xp, CarParameters, (field,))
        return lambda state, episode, time, world: changed(world.car, factor * getattr(world.car, field))

    task = dataclasses.dataclass(frozen=True)(type("Absurd", (Stabilise,), {"conditions": conditions}))()
    with pytest.raises(ValueError, match=f"task Absurd: its law 'conditions' must give a {words}"):
        check(task)
