"""The settings of a learner, searched with Optuna: what `agents.tune --algo` does.

Each trial is a training of its own seed, judged by the success of its best policy on the starts that select, so on no
start that a table reports; the mean return decides between equals. Trials that fall behind the median of the others at
the same share of their steps are given up. The study is in a database that several processes and machines may share.

Settings of this package's own trainers are options of their command lines, those of Stable-Baselines3 stand in a file,
as `agents.train --config` takes it: each trial has one, and the best settings' is written beside the record.
"""

from __future__ import annotations

import importlib
import inspect
import shlex
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from agents import messages, settings
from agents.learner_spaces import SPACES, parameters
from agents.messages import UserError
from agents.run_folder import begun
from bicycle_env import provenance
from bicycle_env.files import anything, mapping, read_json, shown
from bicycle_env.installation import needs

TRAINERS = {
    "native-ppo": "agents.ppo",
    "policy-search": "agents.policy_search",
    "jax-ppo": "agents.ppo_jax",
    **dict.fromkeys(settings.ALGORITHMS, "agents.train"),
}
FIRST_SEED = 1_000_000
"""Of the trainings: far from the seeds that tables report."""
RETURN_SHARE = 1e-6
"""Of the mean return, added to the success."""
STOPPED = "stopped"
STARTUP = 5
"""Trials before any is given up, and points of the curve before one is."""
POINTS = 20
"""Of the curve, as agents.training has them (which imports torch): in steps they lie elsewhere with every rollout."""


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
    config: Path
    """Where the best settings are written as a settings file, if that is how the trainer takes them."""

    @property
    def url(self) -> str:
        """Of the database; by default an SQLite file in the folder."""
        return self.storage or f"sqlite:///{self.folder / 'study.db'}"


class Options:
    """A trainer of this package's own, whose settings are options of its command line."""

    def __init__(self, asked: Search) -> None:
        self._asked, self.module = asked, importlib.import_module(TRAINERS[asked.algo])
        words = ["--env-id", asked.env_id, "--env-keywords", asked.env_keywords]
        self._usual = settings.usual(self.module.Args, asked.algo, words)
        self.shipped: Mapping[str, Any] = vars(self._usual)
        """Settings by name."""
        self.steps: int = asked.total_timesteps or self._usual.total_timesteps
        """Of each training."""

    def arguments(self, chosen: Mapping[str, Any], place: Path, **shared: Any) -> Any:
        """Of a training with these settings in this folder."""
        options = {**self.shipped, "total_timesteps": self.steps, **chosen, **shared, "out": place}
        return self.module.Args(**options)

    def words(self, chosen: Mapping[str, Any]) -> list[str]:
        """Options of a command line that trains with these settings."""
        words = ["--total-timesteps", str(self._asked.total_timesteps)] if self._asked.total_timesteps else []
        for name, value in chosen.items():
            words += [f"--{name.replace('_', '-')}", *(map(str, value) if isinstance(value, list) else [f"{value}"])]
        return words

    def write(self, chosen: Mapping[str, Any], command: str) -> None:
        """Nothing: the command line says all."""


class SettingsFile:
    """Stable-Baselines3, whose settings are a file."""

    def __init__(self, asked: Search) -> None:
        self._asked, self.module = asked, importlib.import_module(TRAINERS[asked.algo])
        self._usual = settings.read(asked.env_id, asked.algo)
        # What the file does not say is as the library has it.
        defaults = inspect.signature(self.module.sb3_state.ALGORITHMS[asked.algo]).parameters
        known = {name: defaults[name].default for name in SPACES[asked.algo] if name in defaults}
        self.shipped: Mapping[str, Any] = {**known, **self._usual.model, **self._usual.network}
        self.steps: int = asked.total_timesteps or self._usual.total_timesteps

    def arguments(self, chosen: Mapping[str, Any], place: Path, **shared: Any) -> Any:
        config = place.with_name(f"{place.name}.toml")
        settings.write(config, self._asked.algo, self._settings(chosen), f"a trial of {self._asked.study}")
        return self.module.Args(algo=self._asked.algo, config=config, out=place, **shared)

    def words(self, _: Mapping[str, Any]) -> list[str]:
        return ["--algo", self._asked.algo, "--config", str(self._asked.config)]

    def write(self, chosen: Mapping[str, Any], command: str) -> None:
        """The settings file that the command line names."""
        settings.write(self._asked.config, self._asked.algo, self._settings(chosen), f"Found by: {command}")

    def _settings(self, chosen: Mapping[str, Any]) -> settings.Settings:
        of_model = settings.MODELS[self._asked.algo]
        return replace(
            self._usual,
            total_timesteps=self.steps,
            model=self._usual.model | {name: value for name, value in chosen.items() if name in of_model},
            network=self._usual.network | {name: value for name, value in chosen.items() if name not in of_model},
        )


Trainer = Options | SettingsFile


def trainer_of(asked: Search) -> Trainer:
    """How the settings come to the trainer."""
    return SettingsFile(asked) if asked.algo in settings.ALGORITHMS else Options(asked)


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
    trainer = trainer_of(asked)
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
        study.enqueue_trial(_enqueued(optuna, trainer.shipped, asked.algo), skip_if_exists=True)
    with messages.progress() as bar:
        job = bar.add_task(asked.study, total=asked.trials)
        while (done := len(_over(study))) < asked.trials:
            best = _best(optuna, study)
            told = "" if best is None else f": best saves {100.0 * best.user_attrs['success_rate']:.1f} %"
            bar.update(job, completed=done, description=f"{asked.study}{told}")
            _one(asked, optuna, study, trainer, Console(quiet=True))
    return record(asked, optuna, study, trainer)


def _enqueued(optuna: Any, shipped: Mapping[str, Any], algo: str) -> dict[str, Any]:
    """Of the shipped settings those that the spaces hold; what they do not hold is drawn."""
    found: dict[str, Any] = {}
    for name, suggest in SPACES[algo].items():
        values = parameters(name, shipped[name])
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Optuna only warns of a number beyond its range
            try:
                suggest(optuna.trial.FixedTrial(values))
            except (ValueError, UserWarning):
                continue
        found |= values
    return found


def _over(study: Any) -> list[Any]:
    """Trials that have finished, were given up or have diverged; those that were stopped do not count."""
    return [one for one in study.trials if one.state.is_finished() and STOPPED not in one.user_attrs]


def _best(optuna: Any, study: Any) -> Any:
    finished = [trial for trial in study.trials if trial.state == optuna.trial.TrialState.COMPLETE]
    return max(finished, key=lambda trial: trial.value, default=None)


def _one(asked: Search, optuna: Any, study: Any, trainer: Trainer, console: Console) -> None:
    """A trial: a training of its own."""
    trial = study.ask()
    chosen = {name: suggest(trial) for name, suggest in SPACES[asked.algo].items()}
    place = asked.folder / f"trial-{trial.number}"
    if begun(place):
        raise UserError(f"--out: {shown(place)} holds a run of another study")

    def watch(timesteps: int, success: float, episode_return: float) -> None:
        # The pruner compares what other trials reported under the same number: the share of the steps.
        trial.report(success + RETURN_SHARE * episode_return, timesteps // max(1, trainer.steps // POINTS))
        if trial.should_prune():
            raise optuna.TrialPruned

    shared = {"env_id": asked.env_id, "env_keywords": asked.env_keywords, "quiet": True, "resume": False}
    arguments = trainer.arguments(chosen, place, seed=FIRST_SEED + trial.number, **shared)
    states = optuna.trial.TrialState
    try:
        trainer.module.train(arguments, console, watch)
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


def command_of(asked: Search, trainer: Trainer, chosen: Mapping[str, Any]) -> str:
    """A training with these settings."""
    words = ["python", "-m", TRAINERS[asked.algo], "--env-id", asked.env_id]
    words += ["--env-keywords", asked.env_keywords] if asked.env_keywords != "{}" else []
    return shlex.join([*words, *trainer.words(chosen)])


def record(asked: Search, optuna: Any, study: Any, trainer: Trainer) -> dict[str, Any]:
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
        "train": command_of(asked, trainer, best.user_attrs["settings"]),
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
