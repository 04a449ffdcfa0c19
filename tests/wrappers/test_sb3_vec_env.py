"""Stable-Baselines3 on the native vector environment: the same numbers as on single environments, to the bit."""

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import ON_ROADS
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NormalizeReward, RecordEpisodeStatistics
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize, VecVideoRecorder

import bicycle_env  # noqa: F401
from bicycle_env.registration import ENVIRONMENTS
from bicycle_env.wrappers import SB3VecEnv

IDS = [row.id for row in ENVIRONMENTS]
ROWS = 5


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def native(env_id="BicycleStab-v0", number=ROWS, **keywords):
    return SB3VecEnv(gym.make_vec(env_id, number, autoreset_mode="SameStep", **{"steer": "both", **keywords}))


def singles(env_id="BicycleStab-v0", number=ROWS, **keywords):
    return DummyVecEnv([lambda: gym.make(env_id, **{"steer": "both", **keywords})] * number)


def actions(number, rows=ROWS, axles=2):
    """A random walk of each row, strong enough to end most episodes early."""
    steps = np.random.default_rng(0).uniform(-0.4, 0.4, (number, rows, axles))
    return np.clip(np.cumsum(steps, axis=0), -1.0, 1.0).astype(np.float32)


def small(algorithm, env, **settings):
    return algorithm("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, device="cpu", seed=0, **settings)


def assert_same_arrays(mine, theirs):
    for one, other in zip(mine, theirs, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


# What a step tells


@pytest.mark.parametrize("telemetry", [False, True])
@pytest.mark.parametrize("env_id", ON_ROADS)
def test_it_is_dummy_vec_env_with_the_single_environments(env_id, telemetry):
    keywords = {"max_episode_steps": 60, "telemetry": telemetry}
    own = {}
    if env_id != ON_ROADS[0]:  # a kind that is compiled for tests/contracts, too
        keywords["tire"], own["friction"] = "tanh", np.ones(ROWS)
    mine, theirs = native(env_id, **keywords, **own), singles(env_id, **keywords)
    mine.seed(3)
    theirs.seed(3)
    assert_same_arrays([mine.reset()], [theirs.reset()])
    end_names, ends = mine.env.end_names, set()
    for action in actions(150):
        *arrays, infos = mine.step(action)
        *expected, wanted = theirs.step(action)
        assert_same_arrays(arrays, expected)
        for over, info, want in zip(arrays[2], infos, wanted, strict=True):
            if not over:
                assert info == {}
                continue
            np.testing.assert_array_equal(info.pop("terminal_observation"), want.pop("terminal_observation"))
            info["end"] = end_names[info["end"]]
            ends.add(info["end"])
            assert info == want
            assert type(info["TimeLimit.truncated"]) is bool
    assert len(ends) >= 2, "the test needs episodes that end and episodes that run out of time"
    assert "" in ends


def test_many_rows_end_where_their_single_environments_end():
    mine = native(number=300, max_episode_steps=40)
    mine.seed(0)
    mine.reset()
    seen = {}
    walk = actions(40, 300)
    for action in walk:
        *_, infos = mine.step(action)
        for row, info in enumerate(infos):
            if info:
                seen.setdefault(row, info)
    assert len(seen) == 300
    for row in range(0, 300, 37):
        env = gym.make("BicycleStab-v0", max_episode_steps=40)
        env.reset(seed=row)
        for action in walk[:, row]:
            last, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                break
        np.testing.assert_array_equal(seen[row]["terminal_observation"], last)
        assert seen[row]["TimeLimit.truncated"] is truncated


def test_an_end_in_the_last_step_is_no_time_out():
    """Both flags are set then: what would have come is worth nothing, and must not be bootstrapped."""
    env = native(max_episode_steps=1)
    spins = np.array([False, True, False, True, True])
    env.set_options({"state": {"heading": np.where(spins, 1.19, 0.0), "yaw_rate": np.where(spins, 1.9, 0.0)}})
    env.reset()
    *_, over, infos = env.step(np.zeros((ROWS, 2), np.float32))
    assert over.all()
    assert [info["TimeLimit.truncated"] for info in infos] == (~spins).tolist()
    told = env.info["final_info"]["end"]
    assert (told > 0).tolist() == spins.tolist()


def test_a_last_observation_is_the_callers():
    """Callbacks keep it: it must not hold the whole array of all rows, nor change with it."""
    env = native(max_episode_steps=1)
    env.reset()
    *_, infos = env.step(np.zeros((ROWS, 2), np.float32))
    kept = [info["terminal_observation"] for info in infos]
    before = np.array(kept)
    env.info["final_obs"][:] = 7.0
    assert np.array_equal(kept, before)
    assert all(one.base is None for one in kept)


def test_nothing_is_shared_between_rows_or_steps():
    env = native(max_episode_steps=3)
    first = env.reset()
    kept = first.copy()
    results = [env.step(action) for action in actions(3)]
    np.testing.assert_array_equal(first, kept)
    infos = results[-1][3]
    whole = infos[1]["terminal_observation"].copy()
    infos[0]["terminal_observation"][:] = np.nan
    results[-1][0][:] = np.nan
    np.testing.assert_array_equal(infos[1]["terminal_observation"], whole)
    assert np.all(np.isfinite(env.step(actions(1)[0])[0]))
    running = results[0][3]
    running[0]["mine"] = 1
    assert running[1] == {}


def test_the_arrays_of_all_rows_are_there_too():
    env = native(telemetry=True)
    env.reset()
    assert set(env.reset_infos[2]) >= {"end", "cost", "sideslip"}
    assert env.reset_infos[2]["sideslip"] == env.info["sideslip"][2]
    env.step(actions(1)[0])
    assert env.info["sideslip"].shape == (ROWS,)


def test_reset_infos_are_those_of_the_running_episode():
    env = native(max_episode_steps=2, telemetry=True)
    env.reset()
    before = [info["sideslip"] for info in env.reset_infos]
    for action in actions(2):
        env.step(action)
    after = [info["sideslip"] for info in env.reset_infos]
    assert after == list(env.info["sideslip"])
    assert after != before


# Seeds and options


def test_a_seed_counts_for_the_next_reset_only():
    env = native()
    assert env.seed(7) == [7, 8, 9, 10, 11]
    first = env.reset()
    single = gym.make("BicycleStab-v0")
    for row in range(ROWS):
        np.testing.assert_array_equal(first[row], single.reset(seed=7 + row)[0])
    assert not np.any(np.all(env.reset() == first, axis=1))
    env.seed(7)
    np.testing.assert_array_equal(env.reset(), first)


def test_options_count_for_the_next_reset_only():
    env = native()
    speeds = np.linspace(0.0, 1.0, ROWS)
    env.set_options({"state": {"lateral_velocity": speeds}})
    env.reset()
    np.testing.assert_array_equal(env.env.state.lateral_velocity, speeds)
    env.reset()
    assert not np.any(env.env.state.lateral_velocity == speeds)


def test_options_by_row_are_refused():
    with pytest.raises(TypeError, match="one mapping for all rows"):
        native().set_options([{"state": {}}] * ROWS)


# What can be asked of it


def test_attributes_and_methods_are_the_vector_environments():
    env = native(max_episode_steps=77)
    env.reset()
    assert env.get_attr("max_episode_steps") == [77] * ROWS
    assert env.get_attr("render_mode", 1) == [None]
    assert env.render_mode is None
    assert env.has_attr("speed")
    assert not env.has_attr("sped")
    (measured,) = env.env_method("measure", indices=[2])
    assert measured["front_slip_angle"].shape == (ROWS,)
    with pytest.raises(AttributeError, match="make_vec"):
        env.set_attr("speed", 10.0)


def test_single_environments_inside_are_asked_and_set_one_by_one():
    vector_kwargs = {"autoreset_mode": AutoresetMode.SAME_STEP}
    env = SB3VecEnv(gym.make_vec("BicycleStab-v0", 2, vectorization_mode="sync", vector_kwargs=vector_kwargs))
    env.seed(1)
    env.reset()
    states = env.get_attr("state")
    assert states[0] != states[1]
    env.set_attr("mark", 4)
    assert env.get_attr("mark", [1]) == [4]
    with pytest.raises(AttributeError, match="mark"):
        env.set_attr("mark", 5, indices=[0])
    assert env.env_method("has_wrapper_attr", "mark") == [True, True]


def test_gymnasiums_sync_vector_env_gives_the_same():
    vector_kwargs = {"autoreset_mode": AutoresetMode.SAME_STEP}
    keywords = {"max_episode_steps": 30}
    sync = gym.make_vec("BicycleStab-v0", ROWS, vectorization_mode="sync", vector_kwargs=vector_kwargs, **keywords)
    mine, theirs = native(**keywords), SB3VecEnv(sync)
    mine.seed(0)
    theirs.seed(0)
    assert_same_arrays([mine.reset()], [theirs.reset()])
    for action in actions(40):
        *arrays, infos = mine.step(action)
        *expected, wanted = theirs.step(action)
        assert_same_arrays(arrays, expected)
        for info, want in zip(infos, wanted, strict=True):
            assert info.keys() == want.keys()
            np.testing.assert_array_equal(info.get("terminal_observation"), want.get("terminal_observation"))


def test_vector_wrappers_count_as_wrappers_of_each_row():
    env = SB3VecEnv(NormalizeReward(RecordEpisodeStatistics(native(max_episode_steps=4).env)))
    assert env.env_is_wrapped(RecordEpisodeStatistics) == [True] * ROWS
    assert env.env_is_wrapped(NormalizeReward, [0, 1]) == [True, True]
    assert native().env_is_wrapped(RecordEpisodeStatistics) == [False] * ROWS
    env.reset()
    for action in actions(4) * 0.1:
        *_, infos = env.step(action)
    assert [info["episode"]["l"] for info in infos] == [4] * ROWS


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_other_autoreset_modes_are_refused(mode):
    with pytest.raises(ValueError, match=r'autoreset_mode="SameStep".*(NEXT_STEP|DISABLED)'):
        SB3VecEnv(gym.make_vec("BicycleStab-v0", 2, autoreset_mode=mode))


def test_only_vector_environments_are_taken():
    with pytest.raises(TypeError, match="make_vec"):
        SB3VecEnv(gym.make("BicycleStab-v0"))


def test_without_stable_baselines3_one_line_says_what_to_install():
    program = (
        "import sys\n"
        "import bicycle_env.wrappers\n"
        "assert not {'stable_baselines3', 'torch'} & set(sys.modules)\n"
        "sys.modules['stable_baselines3'] = None\n"
        "try:\n"
        "    from bicycle_env.wrappers import SB3VecEnv\n"
        "except ModuleNotFoundError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=False)
    assert done.stdout == 'SB3VecEnv needs Stable-Baselines3: pip install -c constraints.txt -e ".[agents]"\n', (
        done.stderr
    )


# Training


def test_ppo_learns_the_same_as_on_single_environments():
    weights = []
    for env in (native(max_episode_steps=25), singles(max_episode_steps=25)):
        model = small(PPO, VecMonitor(env), n_steps=32, batch_size=80, n_epochs=2).learn(320)
        weights.append(torch.nn.utils.parameters_to_vector(model.policy.parameters()))
        assert len(model.ep_info_buffer) >= 2 * ROWS
        assert len(model.ep_success_buffer) == len(model.ep_info_buffer)
    assert torch.equal(*weights)


def test_ppo_bootstraps_at_time_outs_only():
    seen = []

    class Watch(BaseCallback):
        def _on_step(self):
            seen.append((self.locals["rewards"].copy(), self.locals["dones"], self.locals["infos"]))
            return True

    model = small(
        PPO, native(max_episode_steps=40), n_steps=80, batch_size=100, n_epochs=1, learning_rate=0.0, gamma=0.9
    )
    model.learn(80 * ROWS, callback=Watch())
    kinds = set()
    for stored, (rewards, over, infos) in zip(model.rollout_buffer.rewards, seen, strict=True):
        expected = rewards.copy()
        for row in np.flatnonzero(over):
            kinds.add(infos[row]["TimeLimit.truncated"])
            if infos[row]["TimeLimit.truncated"]:
                with torch.no_grad():
                    last = torch.as_tensor(infos[row]["terminal_observation"])[None]
                    expected[row] += 0.9 * model.policy.predict_values(last).item()
        np.testing.assert_allclose(stored, expected, rtol=1e-6)
    assert kinds == {True, False}


def test_sac_stores_last_observations_and_time_outs():
    env = VecMonitor(native(max_episode_steps=40))
    model = small(SAC, env, learning_starts=50, train_freq=4, batch_size=32, buffer_size=1000)
    model.learn(120 * ROWS)
    buffer, used = model.replay_buffer, model.replay_buffer.pos
    assert used == 120
    for k in range(used - 1):
        after, following = buffer.next_observations[k], buffer.observations[k + 1]
        over = buffer.dones[k].astype(bool)
        np.testing.assert_array_equal(after[~over], following[~over])
        assert not np.any(np.all(after[over] == following[over], axis=1)), "the next episode's start, not the end"
    assert np.all(buffer.dones[buffer.timeouts == 1.0] == 1.0)
    assert 0 < buffer.timeouts.sum() < buffer.dones.sum()


def test_vec_normalize_normalises_the_last_observation_like_the_others():
    raw, normal = native(max_episode_steps=10), VecNormalize(native(max_episode_steps=10), norm_reward=False)
    for env in (raw, normal):
        env.seed(2)
        env.reset()
    for action in actions(10):
        *_, infos = raw.step(action)
        *_, normalised = normal.step(action)
    for info, other in zip(infos, normalised, strict=True):
        expected = normal.normalize_obs(info["terminal_observation"])
        np.testing.assert_array_equal(other["terminal_observation"], expected)
        assert not np.array_equal(expected, info["terminal_observation"])


def test_checkpoint_and_resume(tmp_path):
    env = VecNormalize(VecMonitor(native(max_episode_steps=50)))
    model = small(PPO, env, n_steps=64, batch_size=80, n_epochs=2).learn(320)
    model.save(tmp_path / "model")
    env.save(tmp_path / "normalisation")

    fresh = VecNormalize.load(tmp_path / "normalisation", VecMonitor(native(max_episode_steps=50)))
    resumed = PPO.load(tmp_path / "model", fresh, device="cpu")
    np.testing.assert_array_equal(fresh.obs_rms.mean, env.obs_rms.mean)
    observation = np.linspace(-1.0, 1.0, 8, dtype=np.float32)
    assert_same_arrays(
        model.predict(observation, deterministic=True)[:1], resumed.predict(observation, deterministic=True)[:1]
    )
    resumed.learn(320, reset_num_timesteps=False)
    assert resumed.num_timesteps == 640
    assert fresh.obs_rms.count > env.obs_rms.count
    assert not np.array_equal(
        model.predict(observation, deterministic=True)[0], resumed.predict(observation, deterministic=True)[0]
    )


def test_success_is_recorded_at_the_end_and_not_at_the_beginning():
    env = gym.make("BicycleStab-v0", max_episode_steps=60)
    _, info = env.reset(seed=0, options={"state": {}})
    assert info["is_success"] is False
    for _ in range(60):
        *_, truncated, info = env.step(np.zeros(2, np.float32))
    assert truncated
    assert info["is_success"] is True


# Films


def test_it_is_recorded(films, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    many = native(render_mode="rgb_array", render_rows=(0, 1))
    env = VecVideoRecorder(many, str(tmp_path), record_video_trigger=lambda step: step == 0, video_length=2)
    env.reset()
    for action in actions(3):
        env.step(action)
    ((frames, fps),) = films
    assert (len(frames), fps) == (3, 50)
    height, width, _ = many.env.render()[0].shape
    assert frames[0].shape == (2 * height, width, 3)
    assert frames[0][:height].any()
    assert frames[0][height:].any()
    assert np.any(frames[0] != frames[2])
    env.close()
