"""The settings of a learner, searched with Optuna: what `agents.tune --algo` does.

Each trial is a training of its own seed, judged by the success of its best policy on the starts that select, so on no
start that a table reports; the mean return decides between equals. Trials that fall behind the median of the others at
the same share of their steps are given up. The study is in a database that several processes and machines may share.
"""

from __future__ import annotations

import importlib
import shlex
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from types import ModuleType
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from agents import messages, settings
from agents.messages import UserError
from agents.run_folder import begun
from bicycle_env import provenance
from bicycle_env.files import anything, mapping, read_json, shown
from bicycle_env.installation import needs

TRAINERS = {"native-ppo": "agents.ppo", "policy-search": "agents.policy_search", "jax-ppo": "agents.ppo_jax"}
FIRST_SEED = 1_000_000
"""Of the trainings: far from the seeds that tables report."""
RETURN_SHARE = 1e-6
"""Of the mean return, added to the success."""
STOPPED = "stopped"
STARTUP = 5
"""Trials before any is given up, and points of the curve before one is."""

Suggest = Callable[[Any], Any]


def _number(name: str, low: float, high: float, log: bool = False) -> Suggest:
    return lambda trial: trial.suggest_float(name, low, high, log=log)


def _whole(name: str, low: int, high: int) -> Suggest:
    return lambda trial: trial.suggest_int(name, low, high)


def _one_of(name: str, *values: Any) -> Suggest:
    return lambda trial: trial.suggest_categorical(name, list(values))


def _gamma(trial: Any) -> tuple[float, float]:
    """Both ends, as times in decisions."""
    ends = sorted(trial.suggest_float(f"horizon_{end}", 10.0, 1000.0, log=True) for end in ("first", "last"))
    return (round(1.0 - 1.0 / ends[0], 5), round(1.0 - 1.0 / ends[1], 5))


ON_POLICY: dict[str, Suggest] = {
    "decisions": _one_of("decisions", 16, 32, 64, 104),
    "hold": _whole("hold", 1, 8),
    "epochs": _whole("epochs", 2, 10),
    "learning_rate": _number("learning_rate", 1e-4, 5e-3, log=True),
    "gamma": _gamma,
    "gae_lambda": _number("gae_lambda", 0.8, 1.0),
    "entropy": _number("entropy", 1e-6, 1e-2, log=True),
    "width": _one_of("width", 32, 64, 128),
    "deviation": _number("deviation", 0.1, 0.8),
}
SPACES: dict[str, dict[str, Suggest]] = {
    "native-ppo": {
        **ON_POLICY,
        "history": _whole("history", 1, 12),
        "minibatch": _one_of("minibatch", 1024, 2048, 4096),
    },
    "jax-ppo": {**ON_POLICY, "minibatches": _one_of("minibatches", 4, 8, 16)},
    "policy-search": {
        "pairs": _one_of("pairs", 32, 64, 128),
        "starts": _one_of("starts", 8, 16, 32),
        "hold": _whole("hold", 1, 6),
        "history": _whole("history", 1, 4),
        "width": _one_of("width", 8, 16, 32),
        "deviation": _number("deviation", 0.01, 0.3, log=True),
        "learning_rate": _number("learning_rate", 1e-3, 0.1, log=True),
    },
}
"""By trainer, what is searched: names of its options."""


@dataclass(frozen=True)
class Search:
    """What is searched, and where it is kept."""

    env_id: str
    env_keywords: str
    algo: str
    trials: int
    total_timesteps: int | None
    seed: int
    storage: str | None
    study: str
    folder: Path

    @property
    def url(self) -> str:
        """Of the database; by default an SQLite file in the folder."""
        return self.storage or f"sqlite:///{self.folder / 'study.db'}"


def imported() -> Any:
    """Optuna; UserError says how to install it."""
    try:
        return importlib.import_module("optuna")
    except ModuleNotFoundError:
        raise UserError(needs("agents.tune --algo", "optuna", "tune")) from None


def search(asked: Search) -> dict[str, Any]:
    """Drive trials until so many have finished or were given up; gives the record that is written."""
    optuna = imported()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    module = importlib.import_module(TRAINERS[asked.algo])
    words = ["--env-id", asked.env_id, "--env-keywords", asked.env_keywords]
    usual = settings.usual(module.Args, asked.algo, words)
    asked.folder.mkdir(parents=True, exist_ok=True)
    try:
        study = optuna.create_study(
            storage=asked.url,
            study_name=asked.study,
            load_if_exists=True,
            direction="maximize",
            pruner=optuna.pruners.MedianPruner(STARTUP, STARTUP),
        )
    except Exception as error:  # of whatever database
        raise UserError(f"--storage: {shown(error)}") from None
    same = {"env_id": asked.env_id, "env_keywords": asked.env_keywords, "algo": asked.algo}
    for name, value in same.items():
        if (before := study.user_attrs.setdefault(name, value)) != value:
            raise UserError(f"--study {asked.study!r} is of another {name}, {shown(repr(before))}: give another name")
        study.set_user_attr(name, value)
    # One that goes on must not draw the same numbers again.
    study.sampler = optuna.samplers.TPESampler(seed=asked.seed + len(study.trials))
    if not study.trials:  # the shipped settings are the first trial where the spaces hold them
        study.enqueue_trial(_enqueued(optuna, usual, asked.algo), skip_if_exists=True)
    with messages.progress() as bar:
        job = bar.add_task(asked.study, total=asked.trials)
        while (done := len(_over(study))) < asked.trials:
            best = _best(optuna, study)
            told = "" if best is None else f": best saves {100.0 * best.user_attrs['success_rate']:.1f} %"
            bar.update(job, completed=done, description=f"{asked.study}{told}")
            _one(asked, optuna, study, module, usual, Console(quiet=True))
    return record(asked, optuna, study)


def _enqueued(optuna: Any, usual: Any, algo: str) -> dict[str, Any]:
    """Of the shipped settings those that the spaces hold; what they do not hold is drawn."""
    known = {field.name: getattr(usual, field.name) for field in fields(usual)}
    found = {name: known[name] for name in SPACES[algo] if name != "gamma"}
    if "entropy" in found:
        found["entropy"] = max(found["entropy"], 1e-6)
    if "gamma" in SPACES[algo]:
        found |= zip(("horizon_first", "horizon_last"), (1.0 / (1.0 - end) for end in known["gamma"]), strict=True)
    return {name: value for name, value in found.items() if _held(optuna, algo, name, found)}


def _held(optuna: Any, algo: str, name: str, values: dict[str, Any]) -> bool:
    space = SPACES[algo].get(name, SPACES[algo].get("gamma"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # Optuna only warns of a number beyond its range
        try:
            space(optuna.trial.FixedTrial(values))  # type: ignore[misc]
        except (ValueError, UserWarning):
            return False
    return True


def _over(study: Any) -> list[Any]:
    """Trials that have finished, were given up or have diverged; those that were stopped do not count."""
    return [one for one in study.trials if one.state.is_finished() and STOPPED not in one.user_attrs]


def _best(optuna: Any, study: Any) -> Any:
    finished = [trial for trial in study.trials if trial.state == optuna.trial.TrialState.COMPLETE]
    return max(finished, key=lambda trial: trial.value, default=None)


def _one(asked: Search, optuna: Any, study: Any, module: ModuleType, usual: Any, console: Console) -> None:
    """A trial: a training of its own."""
    trial = study.ask()
    chosen = {name: suggest(trial) for name, suggest in SPACES[asked.algo].items()}
    place = asked.folder / f"trial-{trial.number}"
    if begun(place):
        raise UserError(f"--out: {shown(place)} holds a run of another study")

    def watch(timesteps: int, success: float, episode_return: float) -> None:
        trial.report(success + RETURN_SHARE * episode_return, timesteps)
        if trial.should_prune():
            raise optuna.TrialPruned

    shared = {"env_id": asked.env_id, "env_keywords": asked.env_keywords, "out": place, "quiet": True}
    steps = {} if asked.total_timesteps is None else {"total_timesteps": asked.total_timesteps}
    options = {**vars(usual), **shared, **steps, **chosen, "seed": FIRST_SEED + trial.number, "resume": False}
    states = optuna.trial.TrialState
    try:
        module.train(module.Args(**options), console, watch)
    except optuna.TrialPruned:
        study.tell(trial, state=states.PRUNED)
    except UserError:  # it has diverged
        study.tell(trial, state=states.FAIL)
    except BaseException:
        trial.set_user_attr(STOPPED, True)
        study.tell(trial, state=states.FAIL)
        raise
    else:
        best = read_json(place / "run.json", mapping(anything))["best"]
        for name in ("success_rate", "episode_return"):
            trial.set_user_attr(name, best[name])
        trial.set_user_attr("settings", {name: list(v) if isinstance(v, tuple) else v for name, v in chosen.items()})
        study.tell(trial, best["success_rate"] + RETURN_SHARE * best["episode_return"])


def command_of(asked: Search, chosen: Mapping[str, Any]) -> str:
    """A training with these settings."""
    words = ["python", "-m", TRAINERS[asked.algo], "--env-id", asked.env_id]
    words += ["--env-keywords", asked.env_keywords] if asked.env_keywords != "{}" else []
    words += ["--total-timesteps", str(asked.total_timesteps)] if asked.total_timesteps else []
    for name, value in chosen.items():
        words += [f"--{name.replace('_', '-')}", *(map(str, value) if isinstance(value, list) else [f"{value}"])]
    return shlex.join(words)


def record(asked: Search, optuna: Any, study: Any) -> dict[str, Any]:
    """What is written down."""
    best, states = _best(optuna, study), optuna.trial.TrialState
    if best is None:
        raise UserError(f"no trial of {asked.study!r} has finished: all were given up or have diverged")
    finished = sorted(
        (trial for trial in study.trials if trial.state == states.COMPLETE), key=lambda one: one.value, reverse=True
    )
    return {
        **provenance.collect(),
        "env_id": asked.env_id,
        "env_keywords": asked.env_keywords,
        "algo": asked.algo,
        "study": asked.study,
        "trials": {state.name.lower(): sum(one.state == state for one in study.trials) for state in states},
        "settings": best.user_attrs["settings"],
        "success_rate_on_selection_starts": best.user_attrs["success_rate"],
        "seed": FIRST_SEED + best.number,
        "train": command_of(asked, best.user_attrs["settings"]),
        "best_trials": [{"trial": one.number, **one.user_attrs} for one in finished[:10]],
    }


def table(found: Mapping[str, Any]) -> Table:
    """The best trials, for people."""
    counts = ", ".join(f"{count} {name}" for name, count in found["trials"].items() if count)
    shown_table = Table(title=f"{found['study']}: trials {counts}", box=box.SIMPLE_HEAD, title_justify="left")
    names = list(found["settings"])
    for name in ("trial", "success %", "return", *names):
        shown_table.add_column(name.replace("_", " "), justify="right")
    for one in found["best_trials"][:5]:
        values = [one["settings"][name] for name in names]
        words = [" ".join(f"{part:g}" for part in (value if isinstance(value, list) else [value])) for value in values]
        shown_table.add_row(
            str(one["trial"]), f"{100.0 * one['success_rate']:.1f}", f"{one['episode_return']:.1f}", *words
        )
    return shown_table
