"""A trained policy as data: weights in a safetensors file, the rest in a JSON file. numpy suffices to act.

What belongs to the policy and not to the environment stands in its file too: for how long it holds an action, how many
observations it sees, what the mirror image of one is. So it drives the environment that all others drive.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control.policy import Array, Policy
from bicycle_env.control.remembered import Remembered
from bicycle_env.control.rows import product
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
VERSION, BASED_VERSION = 2, 3
"""Of the files that are written, without and with a controller as the base; those of version 1 hold no action, see one
observation and have no mirror image."""
BASE = "base"
"""In policy.json: the controller to whose action the network's is added."""


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
MOST_HELD, MOST_SEEN = 1000, 1000
ACTS: dict[str, Callable[[str, Any], Any]] = {
    "hold": whole_in(1, MOST_HELD),
    "history": whole_in(1, MOST_SEEN),
    "mirror": listed(whole_in(-1, 1), 1, WIDEST),
}
"""How a policy may act: see :class:`Network`."""
DESCRIPTION = table(
    {
        "format": one_of([FORMAT]),
        "version": whole_in(1, BASED_VERSION),
        "env_id": text(200),
        "observation_names": listed(text(200), 1, WIDEST),
        "activation": one_of(ACTIVATIONS),
        "output": one_of(OUTPUTS),
        "layers": listed(listed(whole_in(1, WIDEST), 2, 2), 1, MOST_LAYERS),
        "weights_sha256": text(64),
    },
    {
        "env_keywords": mapping(anything, 100),
        BASE: table({"controller": text(200), "parameters": mapping(anything, 100)}),
    },
    others=True,
)
"""What policy.json must hold; what else stands there is kept, and only what `ACTS` and `BASE` name does anything."""


class Network(Policy):
    """A multilayer perceptron: affine layers with an activation between them, and an output law that bounds the action.

    One car of many is driven as if it were alone, to the bit.

    Args:
        layers: (weight (out, in), bias (out,)) of each affine layer, first to last.
        activation: "tanh" or "relu".
        output: "clip" or "tanh".
        description: what else ``policy.json`` holds: ``env_id``, ``observation_names`` and whatever tells its origin.
            Of it these act: ``hold``, the control steps for which an action is held; ``history``, how many observations
            the first layer takes, those of the last decisions, the newest first, at first all of the start;
            ``mirror``, +1 or -1 for each entry of an observation: then the action is half the difference of those to
            the observation and to its mirror image, so that mirror images are answered by mirror images.

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
        acts = {name: check(name, description[name]) for name, check in ACTS.items() if name in description}
        self._hold, self._history, mirror = acts.get("hold", 1), acts.get("history", 1), acts.get("mirror")
        if mirror is not None and (len(mirror) != len(names) or 0 in mirror):
            raise ValueError(f"mirror must be +1 or -1 for each of {len(names)} observations, got {mirror!r}")
        width = len(names) * self._history
        if not layers:
            raise ValueError("a policy needs at least one layer")
        for k, (weight, bias) in enumerate(layers):
            if weight.ndim != 2 or bias.shape != weight.shape[:1] or weight.shape[1] != width:
                raise ValueError(f"layer {k} has shapes {weight.shape} and {bias.shape}; its input has {width} entries")
            if not (np.all(np.isfinite(weight)) and np.all(np.isfinite(bias))):
                raise ValueError(f"layer {k} has values that are not finite")
            width = weight.shape[0]
        self._mirror = None if mirror is None else np.tile(np.array(mirror, np.float32), self._history)
        self._layers = [(np.ascontiguousarray(weight.T), bias) for weight, bias in layers]
        self._axles, self._entries = width, len(names)
        # Of each car how often it was asked, its last action, and the observations of its last decisions.
        self._remembered = Remembered(1 + width + len(names) * self._history)
        self._activation, self._output = ACTIVATIONS[activation], OUTPUTS[output]
        self.description = {
            **description,
            "format": FORMAT,
            "version": BASED_VERSION if BASE in description else VERSION,
            "activation": activation,
            "output": output,
            "layers": [list(weight.shape) for weight, _ in layers],
        }

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        self._remembered.reset(rows)

    def act(self, observation: Array) -> NDArray[np.float32]:
        cars = np.atleast_2d(np.asarray(observation, np.float32))
        if cars.ndim != 2 or cars.shape[1] != self._entries:
            raise ValueError(
                f"observation must have {self._entries} entries, or rows of them, got shape {np.shape(observation)}"
            )
        actions: NDArray[np.float32] = self._decided(cars) if self._hold == self._history == 1 else self._held(cars)
        return np.asarray(actions.reshape(*np.shape(observation)[:-1], self._axles), np.float32)

    def _held(self, cars: Any) -> Any:
        """The actions where not every call decides, or not on the present observation alone."""
        remembered = self._remembered.of(len(cars))
        asked, actions, seen = np.split(remembered, (1, 1 + self._axles), axis=1)  # views
        first, now = asked[:, 0] == 0.0, asked[:, 0] % self._hold == 0.0
        asked += 1.0
        if np.any(now):
            seen[now] = np.hstack((cars, seen[:, : -cars.shape[1]]))[now]
            seen[first] = np.tile(cars[first], self._history)
            actions[now] = self._decided(seen[now].astype(np.float32))
        return actions.astype(np.float32)

    def _decided(self, seen: Any) -> Any:
        """(cars, axles) of what each sees."""
        if self._mirror is None:
            return self._output(self._raw(seen))
        return self._output(0.5 * (self._raw(seen) - self._raw(seen * self._mirror)))

    def _raw(self, seen: Any) -> Any:
        """What the last layer gives."""
        x: Any = np.asarray(seen, np.float32)
        for weight, bias in self._layers[:-1]:
            x = self._activation(product(x, weight) + bias)
        weight, bias = self._layers[-1]
        return product(x, weight) + bias

    def check_fit(self, plant: Any) -> None:
        """ValueError unless an environment shows and steers what the policy was trained with; both keywords in it."""
        names, axles = self.description["observation_names"], plant.action_space.shape[-1]
        if names == list(plant.observation_names) and self._axles == axles:
            return
        spec = getattr(plant, "spec", None)
        here = {} if spec is None else {key: value for key, value in spec.kwargs.items() if key != "telemetry"}
        raise ValueError(
            f"the policy was trained for {shown(self.description.get('env_id'), 60)} with {len(names)} observations, "
            f"{self._axles} actions and the keywords {shown(json.dumps(self.description.get('env_keywords', {})))}; "
            f"this environment has {len(plant.observation_names)} and {axles}, with the keywords {shown(here)}"
        )

    def arrays(self) -> dict[str, NDArray[np.float32]]:
        """Its weights by name: ``layer0.weight`` (out, in), ``layer0.bias`` (out,), and so on."""
        tensors = {}
        for k, (weight, bias) in enumerate(self._layers):
            tensors[f"layer{k}.weight"] = np.ascontiguousarray(weight.T, np.float32)
            tensors[f"layer{k}.bias"] = np.ascontiguousarray(bias, np.float32)
        return tensors

    def save(self, folder: str | Path) -> None:
        """Write both files into a folder."""
        content = pack_arrays(self.arrays())
        write_bytes(Path(folder) / WEIGHTS_FILE, content)
        write_json(Path(folder) / DESCRIPTION_FILE, {**self.description, "weights_sha256": _sha256(content)})


def read(folder: str | Path) -> Network:
    """The network in the folder that :meth:`Network.save` wrote, without its base; nothing in it is executed.

    Raises:
        FileNotFoundError: a file is missing.
        FileError: a ValueError of one line, which names the file: no folder (an archive of Stable-Baselines3, say), too
            large, damaged, of another format or version, or its parts do not fit together.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise FileError(
            f"{shown(folder)}: a policy is a folder with {DESCRIPTION_FILE} and {WEIGHTS_FILE}, as agents.train writes "
            "it; archives of Stable-Baselines3, pickles and .pt files can hold code, and are not opened here"
        )
    for name in (DESCRIPTION_FILE, WEIGHTS_FILE):
        if not (folder / name).exists():
            raise FileNotFoundError(f"{shown(folder)} is not a policy folder: it has no {name}")
    description = read_json(folder / DESCRIPTION_FILE, DESCRIPTION)
    content = read_bytes(folder / WEIGHTS_FILE, LARGEST)
    if description.pop("weights_sha256") != _sha256(content):
        raise FileError(
            f"{shown(folder / WEIGHTS_FILE)}: does not belong to the {DESCRIPTION_FILE} beside it, or is damaged"
        )
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
    with naming(folder / DESCRIPTION_FILE):  # it announces the shapes, too
        return Network(layers, description["activation"], description["output"], description)


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
