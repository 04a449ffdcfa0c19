"""Checkpoints of earlier revisions: weights, optimizers and replay buffer, in torch's and numpy's files.

They lack the generators and the cars' state, so a run goes on from them, but not as it would have without the stop.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm

from agents import sb3_state
from bicycle_env.files import FileError, naming, read_bytes


def read(place: Path, model: BaseAlgorithm, timesteps: int) -> sb3_state.State:
    """The state for :func:`agents.sb3_state.put`: what the checkpoint holds, and of the rest what the fresh model has.

    Raises:
        FileError: a file is too large or damaged. No code in it is executed.
        OSError: a file cannot be read.
    """
    largest = sb3_state.most_bytes(model)
    state = sb3_state.collect(model)
    state["counters"] = np.array([timesteps, 0, 0], np.int64)
    state |= _weights(place / "model.pt", largest)
    if "buffer.place" in state:
        with _opened(place / "replay_buffer.npz", largest) as content, np.load(content, allow_pickle=False) as arrays:
            for name in sb3_state.BUFFER_ARRAYS:
                state[f"buffer.{name}"] = np.asarray(arrays[name])
            size = model.replay_buffer.buffer_size  # type: ignore[attr-defined]
            full = len(state["buffer.rewards"]) == size
            state["buffer.place"] = np.array([int(arrays["place"]), full], np.int64)
    with naming(place):
        for name, array in state.items():
            if array.dtype.kind == "f" and not np.all(np.isfinite(array)):
                raise ValueError(f"{name!r} has values that are not finite")
    return state


class _opened:  # noqa: N801 (used as a function)
    """A zip file's content, without compression, and any failure of the libraries that read it as FileError."""

    def __init__(self, path: Path, largest: int) -> None:
        self.path, self.largest = path, largest

    def __enter__(self) -> io.BytesIO:
        content = io.BytesIO(read_bytes(self.path, self.largest))
        with naming(self.path):
            try:
                entries = zipfile.ZipFile(content).infolist()
            except (zipfile.BadZipFile, NotImplementedError, EOFError, OverflowError) as error:
                raise ValueError(f"not a zip file: {error}") from None
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
                raise ValueError("a compressed entry, which no checkpoint has")
        content.seek(0)
        return content

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        # torch.load and numpy.load raise of everything on damaged files, document none of it, and advise to trust them.
        if isinstance(error, Exception) and not isinstance(error, (FileError, OSError)):
            with naming(self.path):
                raise ValueError(f"not the weights or the buffer of a checkpoint ({type(error).__name__})") from None


def _weights(path: Path, largest: int) -> sb3_state.State:
    found: dict[str, Any] = {}
    with _opened(path, largest) as content:
        # weights_only: tensors and plain containers, nothing that can run code.
        loaded = torch.load(content, map_location="cpu", weights_only=True)
        if not isinstance(loaded, dict):
            raise TypeError(f"must hold a table, holds a {type(loaded).__name__}")
        for name, part in loaded.items():
            if name == "log_ent_coef":
                found[name] = part
            elif name.endswith("optimizer"):
                found[f"optimizer.{name}.lr"] = torch.tensor(
                    [g["lr"] for g in part["param_groups"]], dtype=torch.float64
                )
                for index, moments in part["state"].items():
                    found |= {f"optimizer.{name}.{index}.{moment}": value for moment, value in moments.items()}
            else:
                found |= {f"{name}.{key}": tensor for key, tensor in part.items()}
        return {name: tensor.detach().numpy().copy() for name, tensor in found.items()}
