"""The benchmark's tables for docs/: every driver of an id and level beneath each other, and what the trainings took.

Only results files are read: the cells of agents.benchmark, the controllers and searches of agents.headroom, the
planning of agents.mpc_headroom. Scores, regrets and times to the best found are by the headroom study of today, for
all rows.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from agents import scores

Row = Mapping[str, Any]

LEARNERS = {
    "native-ppo": "PPO (`agents.ppo`)",
    "policy-search": "evolution strategy (`agents.policy_search`)",
    "sb3-ppo": "PPO (Stable-Baselines3)",
    "sb3-sac": "SAC (Stable-Baselines3)",
}
"""In the order of rows."""
TOLD = {
    "nothing": "MPC, told nothing",
    "friction": "MPC, told the friction",
    "command": "MPC, told what the driver will do",
    "friction and command": "MPC, told both",
}
SEARCHED = ("best found without knowing", "best found")
"""Drivers of agents.headroom that are searches, on starts of their own."""
SHIPPED, PUBLISHED = ", as shipped", "pretrained policy"
LOSES, EVEN, WINS = 0, 1, 2
HEADS = ("driver", "seeds or starts", "success [%]", "on the road [%]", "return", "score", "regret",
         "better than the best classical by [points]")  # fmt: skip
TAKEN = ("id and level", "learner", "seeds", "of the seeds, success [%]", "better by [points]", "million steps",
         "seconds of a training", "seconds to the best found", "machine, date")  # fmt: skip

HEADLINES = (
    ("BicycleStab-v0", "medium", "level with the tuned LQR, above which no search found three points"),
    ("BicycleActiveSteer-v0", "medium", "above linear and switched control"),
    ("BicycleEvade-v0", "medium", "above the tuned path"),
)
"""Ids and levels of which something is claimed, and what."""
CLAIMED = ("claim", "success [%]", "better than the best classical by [points]", "one command", "minutes")


def learner(cell: Row) -> str:
    """A cell's learner, in words."""
    name = LEARNERS.get(cell["learner"], f"`{cell['learner']}`")
    return f"{name}, {cell['variant']}" if cell["variant"] else name


def outcome(cell: Row) -> int:
    """Whether a learner loses to the best classical controller: as sure as the interval of the difference is."""
    low, high = cell["better_than_classical"]["interval"]
    return LOSES if high < 0.0 else WINS if low > 0.0 else EVEN


def drivers(
    cells: Iterable[Row], study: Mapping[str, Row], planned: Mapping[str, Row], path: Path = scores.FILE
) -> str:
    """A table for each id and level that has a cell; those where learning loses stand first.

    Args:
        cells: of agents.benchmark.
        study: the settings of results/headroom.json.
        planned: those of results/mpc.json.
        path: the file of the study, for scores.
    """
    places: dict[str, list[Row]] = {}
    for cell in cells:
        places.setdefault(f"{cell['env_id']} {cell['level']}", []).append(cell)
    order = [*LEARNERS]
    for mine in places.values():
        mine.sort(key=lambda cell: order.index(cell["learner"]) if cell["learner"] in order else len(order))
    ranked = sorted(places, key=lambda place: outcome(best(places[place])))
    return "\n\n".join(
        block(places[place], study.get(place), planned.get(place), scores.known_of(*place.split(), path))
        for place in ranked
    )


def best(cells: Iterable[Row]) -> Row:
    """The learner with the most success."""
    return max(cells, key=lambda cell: float(cell["over_seeds"]["success_rate"]["value"]))


def block(cells: list[Row], part: Row | None, planned: Row | None, known: scores.Known | None) -> str:
    """The drivers of an id and level."""
    rows = {} if part is None else part["drivers"]
    tuned = "" if part is None else part["classical"]["driver"]
    lines = [verdict(cells, rows.get(tuned), known), "", f"| {' | '.join(HEADS)} |", "|---" * len(HEADS) + "|"]
    classical = ["uncontrolled", *(name for name in rows if name.endswith(SHIPPED)), tuned]
    for name in filter(rows.__contains__, classical):
        lines.append(measured(in_words(name), rows[name], known))
    for told, row in ({} if planned is None else planned["mpc"]).items():
        lines.append(measured(TOLD.get(told, f"MPC, told {told}"), row, None))
    for cell in cells:
        count = plural(len(cell["trainings"]), "seed")
        lines.append(measured(learner(cell), {**cell["over_seeds"], **difference(cell)}, known, count))
    if PUBLISHED in rows:
        lines.append(measured("the policy that ships", rows[PUBLISHED], known))
    for name in filter(rows.__contains__, SEARCHED):
        one = "1" if known is not None and name == known.reference and known.has_score else "-"
        lines.append(measured(name, rows[name], None, score=one))
    return "\n".join(lines)


def in_words(driver: str) -> str:
    """A driver of agents.headroom, the controller as code."""
    name, comma, rest = driver.partition(",")
    return f"`{name}`,{rest}" if comma else name


def verdict(cells: list[Row], classical: Row | None, known: scores.Known | None) -> str:
    """What the table says, in a line above it."""
    top = best(cells)
    better, controller = top["better_than_classical"]["value"], top["classical"]["controller"]
    place = f"`{top['env_id']}` {top['level']}"
    points = f"{abs(100 * better):.1f} points {'more' if better > 0.0 else 'less'}"
    words = {LOSES: "learning loses", EVEN: "no learner is surely better", WINS: "learning wins"}[outcome(top)]
    said = f"**{place}: {words}.** The best learner, {learner(top)}, saves "
    said += f"as much as `{controller}`" if better == 0.0 else f"{points} than `{controller}`"
    then = top["classical"]["success_rate"]["value"]
    if classical is not None and abs(then - classical["success_rate"]["value"]) > 1e-9:
        said += f" with parameters of then, which saved {100 * then:.1f} %"
    if known is not None and not known.has_score:
        said += "; no score, the room is three points or less"
    return said + "."


def measured(
    name: str, row: Row, known: scores.Known | None, count: str | None = None, score: str | None = None
) -> str:
    """A driver's row; scores and regrets are affine in success and return, and so are their intervals."""
    success, returned = row["success_rate"], row["episode_return"]
    figures = [figure(success, 100), figure(row["on_road_rate"], 100), figure(returned)]
    if known is None:
        figures += [score or "-", "-"]
    else:
        figures.append(figure(mapped(success, known.score), form=".2f") if known.has_score else "-")
        figures.append(figure(mapped(returned, known.regret)))
    figures.append(compared(row))
    return f"| {name} | {count or plural(row['starts'], 'start')} | {' | '.join(figures)} |"


def mapped(row: Row, law: Any) -> dict[str, Any]:
    """A figure by an affine law, and its interval."""
    return {"value": law(row["value"]), "interval": sorted(law(end) for end in row["interval"])}


def difference(cell: Row) -> dict[str, Any]:
    """For a row: how much better than the best classical controller, and whether it loses."""
    return {"better_than_classical": cell["better_than_classical"], "loses": outcome(cell) == LOSES}


def compared(row: Row) -> str:
    """How much better than the best classical controller, where that was measured on the same starts."""
    if "better_than_classical" not in row:
        return "-"
    return figure(row["better_than_classical"], 100) + (" **loses**" if row.get("loses") else "")


def figure(row: Row, factor: float = 1.0, form: str = ".1f") -> str:
    """A value and its interval."""
    low, high = row["interval"]
    return f"{row['value'] * factor:{form}} [{low * factor:{form}}, {high * factor:{form}}]"


def plural(count: int, noun: str) -> str:
    """With its noun."""
    return f"{count} {noun}{'s' * (count != 1)}"


def trainings(cells: Iterable[Row], path: Path = scores.FILE) -> str:
    """A row for each cell: its seeds, and what they took; those that lose stand first."""
    lines = [f"| {' | '.join(TAKEN)} |", "|---" * len(TAKEN) + "|"]
    for cell in sorted(cells, key=outcome):
        ones = cell["trainings"]
        low, high = (100 * end for end in cell["over_seeds"]["success_rate"]["range"])
        seconds = [one["seconds"] for one in ones]
        row = [f"`{cell['env_id']}` {cell['level']}", learner(cell), str(len(ones)), f"{low:.1f} to {high:.1f}"]
        row += [compared(difference(cell)), millions(statistics.median(one["timesteps"] for one in ones))]
        row += [f"{statistics.median(seconds):.0f}, {min(seconds):.0f} to {max(seconds):.0f}"]
        row += [arrived(ones, scores.known_of(cell["env_id"], cell["level"], path))]
        row += [f"{cell['machine'].partition(',')[0]}, {cell['date']}"]
        lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines)


def headlines(cells: Iterable[Row]) -> str:
    """What is claimed of the best learner of an id and level, and the command that does it again from nothing."""
    lines = [f"| {' | '.join(CLAIMED)} |", "|---" * len(CLAIMED) + "|"]
    there = list(cells)
    for env_id, level, claim in HEADLINES:
        cell = best(one for one in there if (one["env_id"], one["level"]) == (env_id, level))
        ones = cell["trainings"]
        minutes = sum(one["seconds"] for one in ones) / 2.0 / 60.0  # two at a time
        row = [f"`{env_id}` {level}: {claim}"]
        row += [f"{figure(cell['over_seeds']['success_rate'], 100)}, {plural(len(ones), 'seed')}"]
        row += [compared(difference(cell))]
        row += [f"`python -m agents.benchmark --only {env_id} {level} {cell['learner']} --seeds {len(ones)}`"]
        row += [f"{minutes:.0f}, {cell['machine'].partition(',')[0]}"]
        lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines)


def millions(steps: float) -> str:
    """Of steps; of less than three millions with a decimal."""
    return f"{steps / 1e6:.1f}" if steps < 2.95e6 else f"{steps / 1e6:.0f}"


def arrived(ones: list[Row], known: scores.Known | None) -> str:
    """The median time to near the best found, and how many of the seeds came there."""
    if known is None:
        return "-"
    times = [time for one in ones if (time := known.seconds_to_reference(one["curve"])) is not None]
    median = f"{statistics.median(times):.0f}, " if times else ""
    return f"{median}{len(times)} of {len(ones)} seeds"
