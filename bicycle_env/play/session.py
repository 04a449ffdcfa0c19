"""What ``bicycle-env play`` does with its words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym

from bicycle_env import control
from bicycle_env.control import REAR_LAWS, Policy
from bicycle_env.files import checked_output, shown
from bicycle_env.physics.validation import choice
from bicycle_env.play.drives import Drive, caption_of, panels_of, together
from bicycle_env.play.recording import Recording

HUMAN = "human"
ENDINGS = (".gif", ".mp4", ".npz")


class NoDisplayError(RuntimeError):
    """There is nowhere to open a window."""


def environment_ids() -> tuple[str, ...]:
    """The ids of this package that are registered."""
    return tuple(sorted(name for name in gym.registry if name.startswith("Bicycle")))


def policy_of(name: str, env: Any) -> Policy:
    """A policy as ``--policy`` names it: a controller, "pretrained", MODULE:NAME, a folder, or a file of parameters.

    Raises:
        ValueError, TypeError, OSError: in one line: an unknown name, with the nearest known one; one that does not fit.
    """
    known = name in (*control.NAMES, control.PRETRAINED)
    if not known and name.endswith(".json"):
        return control.from_file(name, env)
    if not known and Path(name).is_dir():
        network = control.read(name)
        network.check_fit(env.unwrapped)
        return control.on_base(network, env, name)
    return control.make(name, env)


def human(env: Any, rear: str | None) -> Policy:
    """A human at the front wheels, and the policy `rear` at the others: by default they stay straight."""
    from bicycle_env.play.human import Human

    plant = env.unwrapped
    if plant.steer == "rear":
        raise ValueError(
            "policy 'human' steers the front wheels, and this environment leaves them to its driver: give "
            '--env-keywords \'{"steer": "both"}\''
        )
    if plant.steer == "front":
        if rear is not None:
            raise ValueError(
                f"--rear {shown(rear)}: this environment steers the front wheels only: give "
                '--env-keywords \'{"steer": "both"}\''
            )
        return Human(plant)
    if rear in REAR_LAWS:
        return Human(plant, REAR_LAWS[rear](plant))
    rear = "zero" if rear is None else rear
    if ":" not in rear and not Path(rear).exists():
        choice("--rear", rear, (*REAR_LAWS, *control.NAMES, control.PRETRAINED))
    return Human(plant, policy_of(rear, env))


def play(
    env_id: str,
    policies: Sequence[str],
    *,
    keywords: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    starts: int = 1,
    seed: int = 0,
    rear: str | None = None,
    tell: Callable[[str], object] = print,
) -> None:
    """Drive policies from the same starts, and show them in a window, or write them to a file.

    Args:
        env_id: of a registered environment of the package's kind.
        policies: as :func:`policy_of` takes them, or "human", who needs a window.
        keywords: of the environment.
        out: a file that ends in .gif, .mp4 or .npz; None: a window.
        starts: how many; the k-th is ``reset(seed=seed + k)``, k from 0.
        rear: what steers the rear wheels where a human steers the front ones; also a rear-steer law.
        tell: is given a line about every start.

    Raises:
        ValueError, TypeError, OSError, ModuleNotFoundError, gymnasium.error.Error, NoDisplayError: in one line.
    """
    ending = None if out is None else choice("ending of --out", Path(out).suffix.lower(), ENDINGS)
    if out is not None:
        checked_output(out)
    if ":" not in env_id and env_id not in gym.registry:
        choice("--env-id", env_id, environment_ids())
    if rear is not None and HUMAN not in policies:
        raise ValueError(f"--rear {shown(rear)} is for the policy 'human', which is not among --policy")
    drives, opened = [], []
    try:
        for name in policies:
            opened.append(gym.make(env_id, **{"render_mode": "rgb_array", **(keywords or {})}))
            if not hasattr(opened[-1].unwrapped, "linear_model"):
                raise ValueError(f"--env-id must be of an environment of this package, got {env_id!r}")
            policy = human(opened[-1], rear) if name == HUMAN else policy_of(name, opened[-1])
            drives.append(Drive(name, opened[-1], policy))
        _run(drives, out, ending, range(seed, seed + starts), tell)
    finally:
        for env in opened:
            env.close()


def _run(drives: Sequence[Drive], out: Any, ending: str | None, seeds: range, tell: Callable[[str], object]) -> None:
    plant = drives[0].plant
    drivers = [one.policy for one in drives if hasattr(one.policy, "take")]
    recording = Recording(out) if ending == ".npz" else None
    film = window = None
    if ending in (".gif", ".mp4"):
        from bicycle_env.rendering.moving import FILMS

        film = FILMS[ending](out, plant.action_timestep)
    if out is None or drivers:
        from bicycle_env.play.window import Window

        window = Window(plant.metadata["render_fps"], drivers)

    def show(step: int, over: bool) -> bool:
        filmed = film is not None and (over or step % film.every == 0)
        if not filmed and window is None:
            return True
        if window is not None and not (filmed or over) and window.skips():
            return not window.shut
        from bicycle_env.rendering.moving import share_on_screen, stacked

        panels, caption = panels_of(drives), caption_of(drives)
        if film is not None and filmed:
            film.add(stacked(panels, caption, film.shares[len(panels) > 1]), over)
        if window is None:
            return True
        ready = step == 0 and bool(drivers)  # a human wants to see where the car stands
        return window.show(stacked(panels, caption, share_on_screen(panels)), over or ready)

    driven = 0
    try:
        for k, seed in enumerate(seeds, 1):
            whole = together(drives, seed, show)
            if not whole:
                break
            driven = k
            tell(f"start {k} of {len(seeds)} (seed {seed}): " + ", ".join(f"{one.name} {one.words}" for one in drives))
            if recording is not None:
                recording.add(drives, seed)
    finally:
        if window is not None:
            window.close()
    if driven:
        for file in (film, recording):
            if file is not None:
                file.close()
                tell(f"written: {out}")
