"""A trained policy as data: weights in a safetensors file, the rest in a JSON file. numpy suffices to act."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control.policy import Array, Policy
from bicycle_env.files import write_bytes, write_json

WEIGHTS_FILE = "policy.safetensors"
DESCRIPTION_FILE = "policy.json"
FORMAT = "bicycle-env policy"
VERSION = 1

ACTIVATIONS: dict[str, Callable[[Any], Any]] = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0)}
OUTPUTS: dict[str, Callable[[Any], Any]] = {"clip": lambda x: np.clip(x, -1.0, 1.0), "tanh": np.tanh}
REQUIRED = ("format", "version", "env_id", "observation_names", "activation", "output", "layers", "weights_sha256")


class Network(Policy):
    """A multilayer perceptron: affine layers with an activation between them, and an output law that bounds the action.

    Args:
        layers: (weight (out, in), bias (out,)) of each affine layer, first to last.
        activation: "tanh" or "relu".
        output: "clip" or "tanh".
        description: what else ``policy.json`` holds: ``env_id``, ``observation_names`` and whatever tells its origin.

    Raises:
        ValueError: shapes that do not fit together, values that are not finite, unknown words.
    """

    name = "network"

    def __init__(
        self, layers: list[tuple[Array, Array]], activation: str, output: str, description: dict[str, Any]
    ) -> None:
        if activation not in list(ACTIVATIONS) or output not in list(OUTPUTS):
            raise ValueError(
                f"activation must be one of {', '.join(ACTIVATIONS)} and output one of {', '.join(OUTPUTS)}, "
                f"got {activation!r} and {output!r}"
            )
        names = description["observation_names"]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ValueError(f"observation_names must be a list of names, got {names!r}")
        width = len(names)
        if not layers:
            raise ValueError("a policy needs at least one layer")
        for k, (weight, bias) in enumerate(layers):
            if weight.ndim != 2 or bias.shape != weight.shape[:1] or weight.shape[1] != width:
                raise ValueError(f"layer {k} has shapes {weight.shape} and {bias.shape}; its input has {width} entries")
            if not (np.all(np.isfinite(weight)) and np.all(np.isfinite(bias))):
                raise ValueError(f"layer {k} has values that are not finite")
            width = weight.shape[0]
        self._layers = [(np.ascontiguousarray(weight.T), bias) for weight, bias in layers]
        self._activation, self._output = ACTIVATIONS[activation], OUTPUTS[output]
        self.description = {
            **description,
            "format": FORMAT,
            "version": VERSION,
            "activation": activation,
            "output": output,
            "layers": [list(weight.shape) for weight, _ in layers],
        }

    def act(self, observation: Array) -> NDArray[np.float32]:
        x: Any = np.asarray(observation, np.float32)
        for weight, bias in self._layers[:-1]:
            x = self._activation(x @ weight + bias)
        weight, bias = self._layers[-1]
        return np.asarray(self._output(x @ weight + bias), np.float32)

    def save(self, folder: str | Path) -> None:
        """Write both files into a folder."""
        tensors = {}
        for k, (weight, bias) in enumerate(self._layers):
            tensors[f"layer{k}.weight"] = np.ascontiguousarray(weight.T, np.float32)
            tensors[f"layer{k}.bias"] = np.ascontiguousarray(bias, np.float32)
        content = _safetensors().save(tensors)
        write_bytes(Path(folder) / WEIGHTS_FILE, content)
        write_json(Path(folder) / DESCRIPTION_FILE, {**self.description, "weights_sha256": _sha256(content)})


def load(folder: str | Path) -> Network:
    """Read a policy from the folder that :meth:`Network.save` wrote; nothing in it is executed.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: a file is damaged, of another format or version, or its parts do not fit together.
    """
    folder = Path(folder)
    for name in (DESCRIPTION_FILE, WEIGHTS_FILE):
        if not (folder / name).is_file():
            raise FileNotFoundError(f"{folder} is not a policy folder: it has no {name}")
    try:
        description = json.loads((folder / DESCRIPTION_FILE).read_text(encoding="utf-8"))
        content = (folder / WEIGHTS_FILE).read_bytes()
        tensors = _safetensors().load(content)
    except ModuleNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{folder} holds a damaged policy: {error}") from None
    if not isinstance(description, dict) or any(key not in description for key in REQUIRED):
        raise ValueError(f"{folder / DESCRIPTION_FILE} must have the keys {', '.join(REQUIRED)}")
    if description["format"] != FORMAT or description["version"] != VERSION:
        raise ValueError(
            f"{folder / DESCRIPTION_FILE} must be format {FORMAT!r}, version {VERSION}; "
            f"got {description['format']!r}, {description['version']!r}"
        )
    if description.pop("weights_sha256") != _sha256(content):
        raise ValueError(f"{folder / WEIGHTS_FILE} does not belong to the {DESCRIPTION_FILE} beside it")
    shapes = description["layers"]
    try:
        layers = [(tensors[f"layer{k}.weight"], tensors[f"layer{k}.bias"]) for k in range(len(shapes))]
    except (KeyError, TypeError):
        raise ValueError(f"{folder / WEIGHTS_FILE} lacks layers that {DESCRIPTION_FILE} announces") from None
    if [list(weight.shape) for weight, _ in layers] != shapes or len(tensors) != 2 * len(layers):
        raise ValueError(f"{folder / WEIGHTS_FILE} has other layers than {DESCRIPTION_FILE} announces: {shapes!r}")
    return Network(layers, description["activation"], description["output"], description)


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _safetensors() -> Any:
    try:
        import safetensors.numpy
    except ImportError:
        raise ModuleNotFoundError(
            'policy files need safetensors: pip install "bicycle-env[agents]"', name="safetensors"
        ) from None
    return safetensors.numpy
