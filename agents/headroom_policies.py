"""The policies that ship, in a headroom study that is finished: driven from its starts, minutes instead of an hour.

    python -m agents.headroom_policies results/headroom.json

A policy that came after the study has its row then, and where something is hidden it may be what scores are measured
against. All other rows stay, and the best return; the best found counts what the policy saves as a share, not start by
start. Where a policy is the reference already, its successor is, too: whether the search without knowing stands above
that one, the whole study says. The picture is drawn anew.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from agents import headroom_picture, messages, scores
from agents.episodes import start_seeds
from agents.headroom_figures import of_driver, side
from agents.headroom_setting import BEST, BLIND, BOUND, LEARNED
from agents.messages import UserError
from agents.statistics import bootstrap
from bicycle_env import control, optimum, provenance
from bicycle_env.files import read_json, table, whole_in, write_json

STUDY = table({"settings": table({}, others=True), "seed": whole_in(0, 10**12)}, others=True)
AFTER = (", sees the state", ", knows the friction", BLIND, BEST, BOUND)
"""How the names of the rows end that stand behind the policy's."""


@dataclass
class Args:
    """Drive the policies that ship from the starts of a headroom study, and write their rows into it."""

    study: tyro.conf.Positional[Path] = scores.FILE
    """As agents.headroom has written it."""


def with_policy(part: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """A level's part of the study, with the row of the policy that ships for it.

    Args:
        part: of a level that has such a policy.
        seed: of the study's starts.
    """
    begin = time.perf_counter()
    env_id, level, drivers = part["env_id"], part["level"], dict(part["drivers"])
    classical, best = part["classical"]["driver"], drivers[BEST]
    law = drivers[classical]
    starts = start_seeds(law["starts"], seed)
    cars = optimum.Cars(env_id, {"level": level})
    policy = optimum.drive(cars.of(len(starts)), optimum.by(control.load_policy(env_id, level)), starts)
    seconds = round(time.perf_counter() - begin, 1)
    made_by = {name: provenance.collect()[name] for name in ("git", "date", "machine")}
    row = {**of_driver(policy, "observation", best["starts"], seconds), "made_by": made_by}
    drivers.pop(LEARNED, None)
    if row["success_rate_of_searched"] > best["success_rate"]["value"]:
        searched = optimum.Outcomes(*(column[: best["starts"]] for column in policy))
        own = of_driver(searched, "everything", best["starts"], 0.0)
        same = ("success_rate", "on_road_rate", "success_rate_of_searched")
        drivers[BEST] = {**best, **{name: own[name] for name in same}}
    before = {name: one for name, one in drivers.items() if not name.endswith(AFTER)}
    found = {**part, "drivers": {**before, LEARNED: row, **drivers}}
    if BLIND not in drivers:  # nothing is hidden: the best found is the reference
        return found
    teacher = control.make(law["controller"], cars.plant, parameters=law["parameters"])
    tuned = optimum.drive(cars.of(len(starts)), optimum.by(teacher), starts)
    room = policy.success.astype(float) - tuned.success
    if part["reference"]["driver"] == LEARNED or np.mean(room) > part["room"]["value"]:
        found |= {
            "classical": side(classical, tuned, len(room)),
            "reference": side(LEARNED, policy, len(room)),
            "room": {"value": float(np.mean(room)), "interval": bootstrap(room)},
        }
    return found


def main() -> None:
    args = tyro.cli(Args, prog="python -m agents.headroom_policies", description=__doc__)
    study = read_json(args.study, STUDY, scores.LARGEST)
    if not study["settings"]:
        raise UserError(f"{args.study} holds no setting")
    drawn = args.study.with_suffix(".png")
    messages.check_output("the picture", drawn)
    console, settings = messages.console(), study["settings"]
    for name, part in settings.items():
        if part.get("level") in control.published().get(part["env_id"], ()):
            settings[name] = with_policy(part, study["seed"])
            share = 100.0 * settings[name]["drivers"][LEARNED]["success_rate"]["value"]
            console.print(f"{name}: {share:.1f} %")
    write_json(args.study, study)
    headroom_picture.draw(settings, drawn)
    console.print(f"written: {args.study}, {drawn.name}", soft_wrap=True)


if __name__ == "__main__":
    messages.run(main)
