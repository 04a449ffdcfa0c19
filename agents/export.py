"""From a Stable-Baselines3 model to a policy file's content, checked against the model."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm

from bicycle_env.control import Network

LARGEST_DIFFERENCE = 1e-4
"""Of float32 sums in another order, as a share of what the last layer gives."""


def network(model: BaseAlgorithm, algo: str, description: dict[str, Any]) -> Network:
    """The deterministic policy of an SB3 model with an MLP; RuntimeError if it does not act like the model."""
    modules = _modules(model, algo)
    layers = [
        (layer.weight.detach().cpu().numpy().copy(), layer.bias.detach().cpu().numpy().copy())
        for layer in _linear(modules)
    ]
    result = of_layers(model, algo, layers, description)
    width = layers[0][0].shape[1]
    observations = np.random.default_rng(0).uniform(-1.0, 1.0, (64, width)).astype(np.float32)
    expected, _ = model.predict(observations, deterministic=True)
    difference = float(np.max(np.abs(result.act(observations) - expected)))
    with torch.no_grad():
        sums = torch.nn.Sequential(*modules)(torch.from_numpy(observations))
    if not difference <= LARGEST_DIFFERENCE * max(1.0, float(sums.abs().max())):
        raise RuntimeError(f"the exported policy differs from the model by {difference:g}")
    return result


def of_layers(
    model: BaseAlgorithm, algo: str, layers: list[tuple[NDArray[Any], NDArray[Any]]], description: dict[str, Any]
) -> Network:
    """The policy that the model would have with these affine layers; ValueError for layers of other shapes."""
    modules = _modules(model, algo)
    found, expected = [weight.shape for weight, _ in layers], [layer.weight.shape for layer in _linear(modules)]
    if found != expected:
        raise ValueError(f"the policy's layers must be {list(map(tuple, expected))}, are {list(map(tuple, found))}")
    activation = "tanh" if any(isinstance(module, torch.nn.Tanh) for module in modules) else "relu"
    env: Any = model.get_env()
    names = list(env.get_attr("observation_names")[0])
    return Network(layers, activation, "clip" if algo == "ppo" else "tanh", {**description, "observation_names": names})


def _modules(model: BaseAlgorithm, algo: str) -> list[torch.nn.Module]:
    """What an observation goes through, up to the last affine layer."""
    policy: Any = model.policy
    if algo == "ppo":
        return [*policy.mlp_extractor.policy_net, policy.action_net]
    if algo == "sac":
        return [*policy.actor.latent_pi, policy.actor.mu]
    return [*policy.actor.mu][:-1]  # the last one bounds the action


def _linear(modules: list[torch.nn.Module]) -> list[torch.nn.Linear]:
    return [module for module in modules if isinstance(module, torch.nn.Linear)]
