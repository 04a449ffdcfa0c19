"""A PPO loop written out as CleanRL writes it, straight on ``gym.make_vec``: it learns."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from torch import nn

import bicycle_env  # noqa: F401

NUM_ENVS, NUM_STEPS, ITERATIONS, EPOCHS, MINIBATCHES = 64, 32, 36, 10, 8
GAMMA, GAE_LAMBDA, CLIP, LEARNING_RATE = 0.98, 0.95, 0.2, 1e-3


class Agent(nn.Module):
    def __init__(self, envs):
        super().__init__()
        entries, axles = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
        self.critic = nn.Sequential(nn.Linear(entries, 32), nn.Tanh(), nn.Linear(32, 1))
        self.actor = nn.Sequential(nn.Linear(entries, 32), nn.Tanh(), nn.Linear(32, axles))
        self.log_std = nn.Parameter(torch.full((axles,), -1.0))

    def value(self, observation):
        return self.critic(observation).squeeze(-1)

    def distribution(self, observation):
        return torch.distributions.Normal(self.actor(observation), self.log_std.exp())


def collect(envs, agent, observation):
    """One rollout in the mode SAME_STEP; a time-out is worth what its last observation promises."""
    batch = {name: [] for name in ("observations", "actions", "log_probs", "rewards", "dones", "values")}
    episodes = []
    for _ in range(NUM_STEPS):
        with torch.no_grad():
            distribution = agent.distribution(observation)
            action = distribution.sample()
            value = agent.value(observation)
        following, reward, terminated, truncated, info = envs.step(action.numpy())
        reward = torch.as_tensor(reward, dtype=torch.float32)
        if np.any(truncated):
            rows = np.flatnonzero(truncated)
            with torch.no_grad():
                reward[rows] += GAMMA * agent.value(torch.as_tensor(np.stack(info["final_obs"][rows])))
        if "episode" in info:
            episodes.extend(info["episode"]["r"][info["_episode"]])
        for name, entry in zip(
            batch,
            (observation, action, distribution.log_prob(action).sum(-1), reward, terminated | truncated, value),
            strict=True,
        ):
            batch[name].append(torch.as_tensor(entry))
        observation = torch.as_tensor(following)
    return {name: torch.stack(entries) for name, entries in batch.items()}, observation, episodes


def advantages_of(batch, last_value):
    advantage, following = torch.zeros(NUM_ENVS), last_value
    found = torch.zeros_like(batch["rewards"])
    for k in reversed(range(NUM_STEPS)):
        goes_on = 1.0 - batch["dones"][k].float()
        error = batch["rewards"][k] + GAMMA * following * goes_on - batch["values"][k]
        found[k] = advantage = error + GAMMA * GAE_LAMBDA * goes_on * advantage
        following = batch["values"][k]
    return found


def update(agent, optimizer, batch, advantages):
    returns = (advantages + batch["values"]).flatten()
    flat = {name: entries.flatten(0, 1) for name, entries in batch.items()}
    advantages = advantages.flatten()
    for _ in range(EPOCHS):
        for part in torch.randperm(len(returns)).chunk(MINIBATCHES):
            log_prob = agent.distribution(flat["observations"][part]).log_prob(flat["actions"][part]).sum(-1)
            ratio = (log_prob - flat["log_probs"][part]).exp()
            scaled = (advantages[part] - advantages[part].mean()) / (advantages[part].std() + 1e-8)
            policy_loss = -torch.min(ratio * scaled, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * scaled).mean()
            value_loss = 0.5 * (agent.value(flat["observations"][part]) - returns[part]).square().mean()
            optimizer.zero_grad()
            (policy_loss + 0.5 * value_loss).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimizer.step()


@pytest.fixture
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.exhaustive
def test_a_ppo_loop_learns(one_thread):
    torch.manual_seed(1)
    envs = RecordEpisodeStatistics(gym.make_vec("BicycleStab-v0", NUM_ENVS, autoreset_mode="SameStep"))
    agent = Agent(envs)
    optimizer = torch.optim.Adam(agent.parameters(), lr=LEARNING_RATE, eps=1e-5)
    observation, _ = envs.reset(seed=1)
    observation, curve = torch.as_tensor(observation), []
    for _ in range(ITERATIONS):
        batch, observation, episodes = collect(envs, agent, observation)
        with torch.no_grad():
            last_value = agent.value(observation)
        update(agent, optimizer, batch, advantages_of(batch, last_value))
        if episodes:  # cars that learn well may all still be running
            curve.append(np.mean(episodes))
    assert np.mean(curve[-6:]) > 4.0 * np.mean(curve[:6])
