"""Trainings of less than a second for the tests, and their checkpoints as earlier revisions wrote them."""

from __future__ import annotations

import hashlib
import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.console import Console

from agents import train, training
from bicycle_env.files import pack_arrays, read_arrays

CONFIG = Path(__file__).parent / "short_runs.toml"


def start(algo, folder, resume=False, stop_at=None, number=signal.SIGTERM, console=None, watch=None, **changes):
    """Train; a signal arrives in the middle of the rollout in which `stop_at` is reached."""
    args = replace(train.Args(algo=algo, seed=3, out=folder, quiet=True, config=CONFIG, resume=resume), **changes)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "SELECTED", 16)
        patch.setattr(os, "fsync", lambda _: None)  # dozens of them take long on a busy disk
        if stop_at is not None:
            on_step, sent = train.Record._on_step, []

            def on_step_and_signal(record):
                if record.num_timesteps >= stop_at and not sent:
                    sent.append(signal.raise_signal(number))
                return on_step(record)

            patch.setattr(train.Record, "_on_step", on_step_and_signal)
        train.train(args, console or Console(quiet=True), watch)
    return folder


def arrays(folder):
    """All of a run's state at its end, but for the seconds at which episodes ended."""
    (path,) = (folder / "checkpoint").glob("state-*")
    return {name: array for name, array in read_arrays(path).items() if name != "episodes.t"}


def without_selection(folder):
    """Write the run's checkpoint anew as revisions did whose run ended with the last policy."""
    (path,) = (folder / "checkpoint").glob("state-*")
    content = pack_arrays({name: array for name, array in read_arrays(path).items() if not name.startswith("best")})
    path.unlink()
    digest = hashlib.sha256(content).hexdigest()
    (folder / "checkpoint" / f"state-{digest[:16]}.safetensors").write_bytes(content)
    progress = json.loads((folder / "checkpoint" / "progress.json").read_text())
    progress |= {"digest": digest, "curve": ["16,0.1,0.2500,-12.000,50.0"]}  # of training episodes
    (folder / "checkpoint" / "progress.json").write_text(json.dumps(progress))


def old_checkpoint(folder):
    """Write the run's checkpoint anew as the first revisions did."""
    (path,) = (folder / "checkpoint").glob("state-*")
    found = read_arrays(path)
    state, parts = {}, {"policy": {}}
    for name, array in found.items():
        if name.startswith("policy."):
            parts["policy"][name.removeprefix("policy.")] = torch.from_numpy(array)
        elif name == "log_ent_coef":
            parts[name] = torch.from_numpy(array)
        elif name.startswith("optimizer."):
            owner, _, key = name.removeprefix("optimizer.").rpartition(".")
            if key == "lr":
                parts.setdefault(owner, {"state": {}})["param_groups"] = [{"lr": rate} for rate in array.tolist()]
            else:
                owner, _, index = owner.rpartition(".")
                moments = parts.setdefault(owner, {"state": {}})["state"].setdefault(int(index), {})
                moments[key] = torch.from_numpy(array)
        elif name.startswith("buffer.") and name != "buffer.place":
            state[name.removeprefix("buffer.")] = array
    torch.save(parts, folder / "checkpoint" / "model.pt")
    if state:
        np.savez(folder / "checkpoint" / "replay_buffer.npz", **state, place=found["buffer.place"][0])
    progress = json.loads((folder / "checkpoint" / "progress.json").read_text())
    kept = {key: progress[key] for key in ("timesteps", "seconds", "curve")}
    (folder / "checkpoint" / "progress.json").write_text(json.dumps(kept))
    path.unlink()
