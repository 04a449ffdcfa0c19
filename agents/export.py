"""From a trained SB3 model to a policy file's content, checked against the model."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm

from bicycle_env.control import Network

LARGEST_DIFFERENCE = 1e-4  # float32 sums in another order


def network(model: BaseAlgorithm, algo: str, description: dict[str, Any]) -> Network:
    """The deterministic policy of an SB3 model with an MLP; RuntimeError if it does not act like the model."""
    policy: Any = model.policy
    if algo == "ppo":
        modules = [*policy.mlp_extractor.policy_net, policy.action_net]
        output = "clip"
    elif algo == "sac":
        modules = [*policy.actor.latent_pi, policy.actor.mu]
        output = "tanh"
    else:
        modules = [*policy.actor.mu]
        output = "tanh"
    linear = [module for module in modules if isinstance(module, torch.nn.Linear)]
    layers = [
        (layer.weight.detach().cpu().numpy().copy(), layer.bias.detach().cpu().numpy().copy()) for layer in linear
    ]
    activation = "tanh" if isinstance(modules[1], torch.nn.Tanh) else "relu"
    env: Any = model.get_env()
    names = env.get_attr("observation_names")[0]
    result = Network(layers, activation, output, {**description, "observation_names": list(names)})

    observations = np.random.default_rng(0).uniform(-1.0, 1.0, (64, len(names))).astype(np.float32)
    expected, _ = model.predict(observations, deterministic=True)
    difference = float(np.max(np.abs(result.act(observations) - expected)))
    if not difference <= LARGEST_DIFFERENCE:
        raise RuntimeError(f"the exported policy differs from the model by {difference:g}")
    return result
