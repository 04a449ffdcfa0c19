"""A policy in an archive of Stable-Baselines3. Reading one runs the code in it: only for --trust-pickle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.save_util import load_from_pkl, load_from_zip_file

from agents.messages import UserError
from bicycle_env.control import Policy
from bicycle_env.files import shown

NORMALIZER = "vecnormalize.pkl"


class Archived(Policy):
    """The deterministic policy of a model that Stable-Baselines3 saved, of whichever algorithm, one car at a time.

    Args:
        path: MODEL.zip. Its ``VecNormalize`` is MODEL.pkl or vecnormalize.pkl beside it, if one is there.
        env: that it is to drive.

    Raises:
        UserError: it cannot be read, or is of an environment with other observations or actions.
    """

    def __init__(self, path: Path, env: gym.Env) -> None:
        self.name = str(path)
        torch.set_num_threads(1)  # small networks: more threads only wait for each other
        beside = [place for place in (path.with_suffix(".pkl"), path.with_name(NORMALIZER)) if place.is_file()]
        try:
            data, parameters, _ = load_from_zip_file(path, device="cpu")
            seen, steered = data["observation_space"], data["action_space"]
            keywords = {key: value for key, value in data["policy_kwargs"].items() if key != "device"}
            if data.get("use_sde"):
                keywords["use_sde"] = True
            self._model: Any = data["policy_class"](seen, steered, lambda _: 0.0, **keywords)
            self._model.load_state_dict(parameters["policy"])
            self._normalizer: Any = load_from_pkl(beside[0]) if beside else None
        except Exception as error:  # of whatever is in it
            raise UserError(
                f"{shown(path)}: cannot be read as an archive of Stable-Baselines3: {shown(error)}"
            ) from None
        for what, mine, theirs in (
            ("observations", seen, env.observation_space),
            ("actions", steered, env.action_space),
        ):
            if not isinstance(mine, spaces.Box) or mine.shape != theirs.shape:
                raise UserError(f"{shown(path)}: its {what} are {shown(mine)}, this environment's {shown(theirs)}")
        self._state: Any = None

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:  # noqa: ARG002
        self._state = None

    def act(self, observation: Any) -> NDArray[np.float32]:
        seen = observation if self._normalizer is None else self._normalizer.normalize_obs(observation)
        action, self._state = self._model.predict(seen, self._state, deterministic=True)
        return np.asarray(action, np.float32)
