"""Policies to be looked at, in a window or a file, several from the same start; or a human who steers. On top."""

from __future__ import annotations

from bicycle_env.play.drives import Drive, caption_of, panels_of, together
from bicycle_env.play.session import ENDINGS, HUMAN, NoDisplayError, environment_ids, play, policy_of

__all__ = [
    "ENDINGS",
    "HUMAN",
    "Drive",
    "NoDisplayError",
    "caption_of",
    "environment_ids",
    "panels_of",
    "play",
    "policy_of",
    "together",
]
