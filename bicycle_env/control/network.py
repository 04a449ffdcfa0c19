"""A trained policy as data: weights in a safetensors file, the rest in a JSON file. numpy suffices to act."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control.policy import Array, Policy
from bicycle_env.files import (
    FileError,
    anything,
    listed,
    mapping,
    naming,
    one_of,
    pack_arrays,
    read_bytes,
    read_json,
    shown,
    table,
    text,
    unpack_arrays,
    whole_in,
    write_bytes,
    write_json,
)

WEIGHTS_FILE = "policy.safetensors"
DESCRIPTION_FILE = "policy.json"
FORMAT = "bicycle-env policy"
VERSION = 1


def relu(x: Any) -> Any:
    """max(x, 0)."""
    return np.maximum(x, 0.0)


def clip(x: Any) -> Any:
    """x, limited to [-1, 1]."""
    return np.clip(x, -1.0, 1.0)


ACTIVATIONS: dict[str, Callable[[Any], Any]] = {"tanh": np.tanh, "relu": relu}
OUTPUTS: dict[str, Callable[[Any], Any]] = {"clip": clip, "tanh": np.tanh}
LARGEST = 100_000_000  # bytes of the weights
MOST_LAYERS, WIDEST = 100, 100_000
DESCRIPTION = table(
    {
        "format": one_of([FORMAT]),
        "version": whole_in(VERSION, VERSION),
        "env_id": text(200),
        "observation_names": listed(text(200), 1, WIDEST),
        "activation": one_of(ACTIVATIONS),
        "output": one_of(OUTPUTS),
        "layers": listed(listed(whole_in(1, WIDEST), 2, 2), 1, MOST_LAYERS),
        "weights_sha256": text(64),
    },
    {"env_keywords": mapping(anything, 100)},
    others=True,
)
"""What policy.json must hold; what else stands there is kept, and nothing is done with it."""


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
        content = pack_arrays(tensors)
        write_bytes(Path(folder) / WEIGHTS_FILE, content)
        write_json(Path(folder) / DESCRIPTION_FILE, {**self.description, "weights_sha256": _sha256(content)})


def load(folder: str | Path) -> Network:
    """Read a policy from the folder that :meth:`Network.save` wrote; nothing in it is executed.

    Raises:
        FileNotFoundError: a file is missing.
        FileError: a ValueError of one line, which names the file: no folder (an archive of Stable-Baselines3, say), too
            large, damaged, of another format or version, or its parts do not fit together.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise FileError(
            f"{shown(folder)}: a policy is a folder with {DESCRIPTION_FILE} and {WEIGHTS_FILE}, as agents.train writes "
            "it; archives of Stable-Baselines3, pickles and .pt files can hold code, and are never opened"
        )
    for name in (DESCRIPTION_FILE, WEIGHTS_FILE):
        if not (folder / name).exists():
            raise FileNotFoundError(f"{shown(folder)} is not a policy folder: it has no {name}")
    description = read_json(folder / DESCRIPTION_FILE, DESCRIPTION)
    content = read_bytes(folder / WEIGHTS_FILE, LARGEST)
    if description.pop("weights_sha256") != _sha256(content):
        raise FileError(f"{shown(folder / WEIGHTS_FILE)}: does not belong to the {DESCRIPTION_FILE} beside it")
    tensors = unpack_arrays(content, folder / WEIGHTS_FILE)
    with naming(folder / WEIGHTS_FILE):
        shapes = description["layers"]
        names = [f"layer{k}.{part}" for k in range(len(shapes)) for part in ("weight", "bias")]
        if missing := [name for name in names if name not in tensors]:
            raise ValueError(f"lacks layers that {DESCRIPTION_FILE} announces: {', '.join(missing)}")
        layers = [(tensors[weight], tensors[bias]) for weight, bias in zip(names[::2], names[1::2], strict=True)]
        if [list(weight.shape) for weight, _ in layers] != shapes or len(tensors) != len(names):
            raise ValueError(f"has other layers than {DESCRIPTION_FILE} announces: {shapes!r}")
        if any(array.dtype != np.float32 for array in tensors.values()):
            raise ValueError("the layers must be of dtype F32")
        return Network(layers, description["activation"], description["output"], description)


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
