"""A policy file is the model that was trained, or it is not written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from agents import export, settings, train

DESCRIPTION = {"env_id": "BicycleStab-v0"}


def model(folder, algo, scale, width):
    chosen = settings.read("BicycleStab-v0", algo)
    chosen = replace(chosen, n_envs=64, network={**chosen.network, "net_arch": width})
    made = train.build(train.Args(algo=algo), chosen, {}, folder)
    with torch.no_grad():
        for tensor in made.policy.parameters():
            tensor.mul_(scale)
            if tensor.ndim == 1:
                tensor.add_(0.1)
    return made


@pytest.mark.parametrize("algo", ["ppo", "sac", "td3"])
def test_a_network_that_acts_otherwise_is_refused(tmp_path, algo, monkeypatch):
    made, of_layers = model(tmp_path, algo, 1.0, [16]), export.of_layers
    assert export.network(made, algo, DESCRIPTION).description["layers"] == [[16, 8], [2, 16]]

    def without_a_bias(model, algo, layers, description):
        return of_layers(model, algo, [(layers[0][0], 0.0 * layers[0][1]), *layers[1:]], description)

    monkeypatch.setattr(export, "of_layers", without_a_bias)
    with pytest.raises(RuntimeError, match="differs from the model"):
        export.network(made, algo, DESCRIPTION)


def test_large_weights_are_no_other_network(tmp_path, monkeypatch):
    """A policy on its way to divergence is told by its success: the rounding of large sums is no mistake."""
    monkeypatch.setattr(export, "LARGEST_DIFFERENCE", 1e-6)
    made = model(tmp_path, "td3", 10.0, [256, 256, 256])
    found = export.network(made, "td3", DESCRIPTION)
    observations = np.random.default_rng(0).uniform(-1.0, 1.0, (64, 8)).astype(np.float32)
    assert np.max(np.abs(found.act(observations) - made.predict(observations, deterministic=True)[0])) > 1e-6


def test_layers_of_other_shapes_are_refused(tmp_path):
    made = model(tmp_path, "sac", 1.0, [16])
    with pytest.raises(ValueError, match=r"must be \[\(16, 8\), \(2, 16\)\], are \[\(16, 8\)\]"):
        export.of_layers(made, "sac", [(np.zeros((16, 8)), np.zeros(16))], DESCRIPTION)
