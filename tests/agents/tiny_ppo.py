"""Trainings by agents.ppo that take a fraction of a second, for tests; their cars and those of others compile alike."""

from __future__ import annotations

import os
import signal
from dataclasses import replace

import pytest
from rich.console import Console

from agents import ppo, training
from bicycle_env import provenance

TINY = ppo.Args(
    seed=3, quiet=True, total_timesteps=3072, cars=16, decisions=8, hold=2, history=2, epochs=2, minibatch=64, width=8
)  # 12 updates of 256 control steps, each with a point of the curve
UPDATE = 256
MADE_BY = provenance.collect()  # once: somebody may commit while tests run


def start(folder, stop_at=None, number=signal.SIGTERM, spoil=None, console=None, made_by=MADE_BY, **changes):
    """Train; a signal comes in the update that begins at `stop_at` steps; `spoil(learner, k)` after update k."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "SELECTED", 16)
        patch.setattr(provenance, "collect", lambda: made_by)
        patch.setattr(os, "fsync", lambda _: None)  # dozens of them take long on a busy disk
        drive, learn, count = ppo.drive, ppo.learn, [0, 0]

        def drive_and_signal(*arguments, **keywords):
            if count[0] * UPDATE == stop_at:
                signal.raise_signal(number)
            count[0] += 1
            return drive(*arguments, **keywords)

        def learn_and_spoil(args, learner, *arguments, **keywords):
            learn(args, learner, *arguments, **keywords)
            count[1] += 1
            if spoil is not None:
                spoil(learner, count[1])

        patch.setattr(ppo, "drive", drive_and_signal)
        patch.setattr(ppo, "learn", learn_and_spoil)
        ppo.train(replace(TINY, out=folder, **changes), console or Console(quiet=True))
    return folder


def curve(folder):
    """The learning curve without its seconds."""
    rows = [row.split(",") for row in (folder / "curve.csv").read_text().splitlines()]
    return [[steps, *means] for steps, _, *means in rows]
