"""What `agents.tune --algo` searches: for each trainer, ranges of its settings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Suggest = Callable[[Any], Any]
"""``suggest(trial)``: the value of a setting."""
LEAST_ENTROPY = 1e-6
"""Of the entropy's weight, which is searched on a logarithmic scale; no weight is tried as this one."""


def _number(name: str, low: float, high: float, log: bool = False) -> Suggest:
    return lambda trial: trial.suggest_float(name, low, high, log=log)


def _whole(name: str, low: int, high: int) -> Suggest:
    return lambda trial: trial.suggest_int(name, low, high)


def _one_of(name: str, *values: Any) -> Suggest:
    return lambda trial: trial.suggest_categorical(name, list(values))


def _discount(trial: Any, name: str) -> float:
    """By its horizon in decisions, on which a discount of 0.98 and one of 0.99 are as far apart as they act."""
    return round(1.0 - 1.0 / float(trial.suggest_float(name, 10.0, 1000.0, log=True)), 5)


def _gammas(trial: Any) -> tuple[float, float]:
    """Both ends."""
    first, last = sorted(_discount(trial, f"horizon_{end}") for end in ("first", "last"))
    return first, last


def _gamma(trial: Any) -> float:
    return _discount(trial, "horizon")


def _net_arch(trial: Any) -> list[int]:
    """Two layers of one width."""
    return [trial.suggest_categorical("width", [32, 64, 128, 256])] * 2


OWN_PPO: dict[str, Suggest] = {
    "decisions": _one_of("decisions", 16, 32, 64, 104),
    "hold": _whole("hold", 1, 8),
    "epochs": _whole("epochs", 2, 10),
    "learning_rate": _number("learning_rate", 1e-4, 5e-3, log=True),
    "gamma": _gammas,
    "gae_lambda": _number("gae_lambda", 0.8, 1.0),
    "entropy": _number("entropy", LEAST_ENTROPY, 1e-2, log=True),
    "width": _one_of("width", 32, 64, 128),
    "deviation": _number("deviation", 0.1, 0.8),
}
# Of Stable-Baselines3 as many cars as the shipped settings say: they are what the machine is fast with.
OFF_POLICY: dict[str, Suggest] = {
    "learning_rate": _number("learning_rate", 1e-4, 5e-3, log=True),
    "gamma": _gamma,
    "tau": _number("tau", 1e-3, 0.05, log=True),
    "batch_size": _one_of("batch_size", 64, 128, 256, 512),
    "train_freq": _one_of("train_freq", 1, 2, 4, 8),
    "gradient_steps": _one_of("gradient_steps", 1, 2, 4, 8),
    "net_arch": _net_arch,
}
SPACES: dict[str, dict[str, Suggest]] = {
    "native-ppo": {
        **OWN_PPO,
        "history": _whole("history", 1, 12),
        "minibatch": _one_of("minibatch", 1024, 2048, 4096),
    },
    "jax-ppo": {**OWN_PPO, "minibatches": _one_of("minibatches", 4, 8, 16)},
    "policy-search": {
        "pairs": _one_of("pairs", 32, 64, 128),
        "starts": _one_of("starts", 8, 16, 32),
        "hold": _whole("hold", 1, 6),
        "history": _whole("history", 1, 4),
        "width": _one_of("width", 8, 16, 32),
        "deviation": _number("deviation", 0.01, 0.3, log=True),
        "learning_rate": _number("learning_rate", 1e-3, 0.1, log=True),
    },
    "ppo": {
        "learning_rate": _number("learning_rate", 1e-4, 5e-3, log=True),
        "gamma": _gamma,
        "gae_lambda": _number("gae_lambda", 0.8, 1.0),
        "n_steps": _one_of("n_steps", 8, 16, 32, 64),
        "batch_size": _one_of("batch_size", 512, 1024, 2048, 4096),
        "n_epochs": _whole("n_epochs", 2, 10),
        "ent_coef": _number("ent_coef", LEAST_ENTROPY, 1e-2, log=True),
        "clip_range": _number("clip_range", 0.1, 0.4),
        "net_arch": _net_arch,
        "log_std_init": _number("log_std_init", -2.5, 0.0),
    },
    "sac": OFF_POLICY,
    "td3": {
        **OFF_POLICY,
        "action_noise": _number("action_noise", 0.03, 0.6, log=True),
        "target_policy_noise": _number("target_policy_noise", 0.05, 0.5),
        "policy_delay": _whole("policy_delay", 1, 4),
    },
}
"""By trainer, what is searched: names of its settings."""


def parameters(name: str, value: Any) -> dict[str, Any]:
    """What a study calls the value of a setting, by the names of the parameters that suggest it."""
    if name == "gamma":
        many = isinstance(value, (tuple, list))
        names, ends = (("horizon_first", "horizon_last"), value) if many else (("horizon",), (value,))
        return {name: 1.0 / (1.0 - end) for name, end in zip(names, ends, strict=True) if end < 1.0}
    if name == "net_arch":
        return {"width": value[0]} if len(set(value)) == 1 and len(value) == 2 else {}
    if name in ("entropy", "ent_coef"):
        return {name: max(value, LEAST_ENTROPY)}
    return {name: value}
