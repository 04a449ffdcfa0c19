"""Write the tables of the README and of docs/ from the results files: `python tools/readme_tables.py`.

`--check` only compares.

A table stands between `<!-- results: NAME -->` and `<!-- end -->`; NAME is one of the functions below. Only the one of
the levels comes from the tasks instead.
"""

from __future__ import annotations

import argparse
import re
import statistics
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from gymnasium.envs.registration import load_env_creator

from bicycle_env import Actuator
from bicycle_env.files import read_json
from bicycle_env.registration import ENVIRONMENTS

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))  # agents/ is no part of the package

from agents import benchmark_tables  # noqa: E402

PAGES = (
    *("README.md", "docs/performance.md", "docs/levels.md", "docs/headroom.md", "docs/reward.md"),
    *("docs/learning.md", "docs/results.md", "docs/libraries.md", "docs/scaling.md"),
)
DEGREES = 57.29577951308232
BEYOND = "peak_sideslip_beyond_0.3"


def read(name: str) -> dict[str, Any]:
    return read_json(ROOT / "results" / name)


def cell(row: dict[str, Any], key: str, factor: float = 1.0, form: str = ".1f") -> str:
    if key not in row:
        return "-"
    low, high = row[key]["interval"]
    return f"{row[key]['value'] * factor:{form}} [{low * factor:{form}}, {high * factor:{form}}]"


def made(result: dict[str, Any], more: str) -> str:
    return f"`{result['command']}`, {result['date']}, {result['machine']}; {more}"


def demo() -> str:
    result = read("demo.json")
    names = {"zero": "uncontrolled", "lqr": "LQR", "learned": "evolution strategy (`agents.policy_search`), one seed"}
    lines = [
        "| 200 starts, the same | success [%] | on the road [%] | mean return (of 400) | peak sideslip [deg] "
        "| steering effort [deg] |",
        "|---|---|---|---|---|---|",
    ]
    for key, name in names.items():
        row = result["policies"][key]
        lines.append(
            f"| {name} | {cell(row, 'success_rate', 100)} | {cell(row, 'on_road_rate', 100)} "
            f"| {cell(row, 'episode_return')} "
            f"| {cell(row, 'peak_sideslip', DEGREES)} | {cell(row, 'steering_effort', DEGREES, '.2f')} |"
        )
    more = (
        f"training seed {result['training_seed']}, starts from seed {result['evaluation_seed']}, training "
        f"{result['training_seconds']:.0f} s; `results/demo.json`. In brackets: 95 % intervals."
    )
    return "\n".join([*lines, "", made(result, more)])


def learning(file: str, columns: list[tuple[str, str, float, str]]) -> str:
    result = read(file)
    count = len(result["seeds"])
    rows = {
        "uncontrolled": result["controllers"]["zero"],
        "LQR" + (" with preview" if "LaneChange" in file else ""): result["controllers"]["lqr"],
        f"{result['algo'].upper()} (Stable-Baselines3), {count} seeds": result["over_seeds"],
    }
    lines = [
        "| 200 starts, the same for all | " + " | ".join(heading for _, heading, _, _ in columns) + " |",
        "|---" * (len(columns) + 1) + "|",
    ]
    for name, row in rows.items():
        cells = [cell(row, key, factor, form) for key, _, factor, form in columns]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    slowest = max(training["seconds"] for training in result["trainings"])
    more = (
        f"training seeds 0 to {count - 1}, {result['trainings'][0]['timesteps']:,} steps each, the slowest "
        f"{slowest:.0f} s on one core; starts from seed {result['evaluation_seed']}; worst seed's success "
        f"{100 * result['over_seeds']['success_rate']['range'][0]:.1f} %; `results/{file}`. {result['algo'].upper()}: "
        "interquartile mean over seeds [95 % bootstrap interval]; controllers: mean over starts [95 % interval]."
    )
    return "\n".join([*lines, "", made(result, more)])


STAB = [
    ("success_rate", "success [%]", 100, ".1f"),
    ("on_road_rate", "on the road [%]", 100, ".1f"),
    ("episode_return", "mean return (of 400)", 1, ".1f"),
    ("peak_sideslip", "peak sideslip [deg]", DEGREES, ".1f"),
    ("steering_effort", "steering effort [deg]", DEGREES, ".2f"),
]
LANE_CHANGE = [
    ("success_rate", "success [%]", 100, ".1f"),
    ("on_road_rate", "on the road [%]", 100, ".1f"),
    ("episode_return", "mean return (of 300)", 1, ".1f"),
    ("largest_tracking_error", "largest tracking error [m]", 1, ".2f"),
    ("overshoot", "overshoot [m]", 1, ".2f"),
    ("settling_time", "settling time [s]", 1, ".2f"),
    ("steering_effort", "steering effort [deg]", DEGREES, ".2f"),
]


def stab_ppo() -> str:
    return learning("BicycleStab-v0-ppo.json", STAB)


def lane_change_ppo() -> str:
    return learning("BicycleLaneChange-v0-ppo.json", LANE_CHANGE)


def controllers(file: str, columns: list[tuple[str, str, float, str]]) -> str:
    result = read(file)
    lines = [
        "| 200 starts, the same for all | " + " | ".join(heading for _, heading, _, _ in columns) + " |",
        "|---" * (len(columns) + 1) + "|",
    ]
    for name, row in result["policies"].items():
        cells = [cell(row, key, factor, form) for key, _, factor, form in columns]
        lines.append(f"| `{name}` | " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", made(result, f"`results/{file}`. In brackets: 95 % intervals.")])


def controllers_stab() -> str:
    return controllers("controllers_stab.json", STAB)


def controllers_lane_change() -> str:
    (sideslip,) = (column for column in STAB if column[0] == "peak_sideslip")
    return controllers("controllers_lane_change.json", [*LANE_CHANGE[:-1], sideslip])


def speed() -> str:
    result = read("single_env.json")
    lines = ["| steps per second through `gym.make` | |", "|---|---|"]
    names = {"Nothing-v0": "an environment whose step does nothing"}
    lines += [f"| {names.get(name, name)} | {rate:,} |" for name, rate in result["steps_per_second"].items()]
    ratios = ", ".join(f"{name}: {ratio:g}" for name, ratio in result["ratios"].items())
    shares = ", ".join(f"{name}: {share:.0%}" for name, share in result["share_of_nothing"].items())
    more = f"Ratios in this run: {ratios}. Share of an environment whose step does nothing: {shares}."
    return "\n".join([*lines, "", f"`make benchmark`, {result['date']}, {result['machine']}. {more}"])


def vector() -> str:
    result = read("vector_env.json")
    lines = ["| what | measured | must | rows/s, ours | rows/s, theirs |", "|---|---|---|---|---|"]
    for row in result["ratios"]:
        short = "" if row["ratio"] >= row["must"] else " **short**"
        rates = [f"{row[key]:,}" if key in row else "-" for key in ("ours", "theirs")]
        lines.append(f"| {row['row']} | {row['ratio']:g}{short} | {row['must']:g} | {rates[0]} | {rates[1]} |")
    lines += [f"| {name} | not measured | | | |" for name in result["not measured"]]
    size = result["bytes per car"]
    more = (
        f"Python {result['versions']['python']}. First step in a new process, everything compiled before: "
        f"{result['first step in a new process, s']:g} s. Memory per car: {size['blocks']:g} bytes of numbers, "
        f"{size['generators and a reset']:g} with its random generator. `results/vector_env.json`."
    )
    return "\n".join([*lines, "", made(result, more)])


def one_car() -> str:
    result = read("one_car.json")
    lines = ["| one car | microseconds a step |", "|---|---|"]
    lines += [f"| {name} | {value:.2f} |" for name, value in result["microseconds a step"].items()]
    return "\n".join([*lines, "", made(result, f"{result['tire']} tire. `results/one_car.json`.")])


def tensors() -> str:
    return tensors_table("torch_env.json")


def gpu() -> str:
    return tensors_table("torch_env_gpu.json")


def tensors_table(file: str) -> str:
    result = read(file)
    sizes = list(result["rows"][0]["steps_per_second"])
    lines = [
        "| steps per second | " + " | ".join(f"{int(size):,} cars" for size in sizes) + " | first steps |",
        "|---" * (len(sizes) + 2) + "|",
    ]
    for row in result["rows"]:
        how = "native" if row["what"] == "native" else "tensors, compiled" if row["compile"] else "tensors"
        rates = " | ".join(f"{rate:,}" for rate in row["steps_per_second"].values())
        first = max(row["first_steps_seconds"].values())
        lines.append(f"| {how}, {row['device']}, {row['dtype']} | {rates} | {first:.1f} s |")
    return "\n".join([*lines, "", made(result, f"one thread; GPU: {result['gpu']}. `results/{file}`.")])


def scaling() -> str:
    """Trainings side by side."""
    result = read("scaling.json")
    heads = ["steps per second, each", "together", "efficiency", "with the start"]
    lines = ["| trainings at a time | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for row in result["rows"]:
        cells = [f"{row['steps_per_second'] / row['at_once']:,.0f}", f"{row['steps_per_second']:,}"]
        cells += [f"{row['of_as_many']:.0%}", f"{row['with_the_start']:,}"]
        lines.append(f"| {row['at_once']} | " + " | ".join(cells) + " |")
    one = result["rows"][0]
    load = result["load_before"]
    more = (
        f"`agents.ppo` on `{result['env_id']}`, {result['steps']:,} steps each, the best of {result['rounds']}. "
        f"{one['cars']} cars alone, without a learner, make {result['cars_alone']:,} steps per second on one core: of "
        f"a training's second they take {one['steps_per_second'] / result['cars_alone']:.1%}. "
        + (f"Load of the machine before: {load:.1f}. " if load is not None else "")
        + "`results/scaling.json`."
    )
    quick = "**A quick run: it shows that the command works, and says nothing about the machine.** "
    return "\n".join([*lines, "", quick * result["quick"] + made(result, more)])


def percent(row: dict[str, Any] | None) -> str:
    return "-" if row is None else cell(row, "success_rate", 100)


def headroom() -> str:
    """Of each level: nobody, the best classical controller, those that know more, the bound, and the room."""
    result = read("headroom.json")
    heads = ["nobody", "best classical, tuned", "the law that knows the friction", "pretrained policy"]
    heads += ["best found without knowing", "best found", "bound", "room [points]", "the optimum is"]
    lines = ["| success [%] | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for part in result["settings"].values():
        if part["level"]:
            rows, best, room = part["drivers"], part["classical"]["driver"], part["room"]
            low, high = (100 * end for end in room["interval"])
            knowing = next((row for driver, row in rows.items() if driver.endswith("knows the friction")), None)
            cells = [percent(rows["uncontrolled"]), f"{percent(rows[best])} `{best.removesuffix(', tuned')}`"]
            others = ("pretrained policy", "best found without knowing", "best found", "upper bound")
            cells += [percent(one) for one in (knowing, *map(rows.get, others))]
            cells += [f"{100 * room['value']:.1f} [{low:.1f}, {high:.1f}]"]
            cells.append(optimum(part))
            lines.append(f"| `{part['env_id']}` {part['level']} | " + " | ".join(cells) + " |")
    counts = {row["starts"] for part in result["settings"].values() for row in part["drivers"].values()}
    processor = sum(part["processor_seconds"] for part in result["settings"].values()) / 60
    more = (
        f'{max(counts)} starts for the controllers, the first 200 of them for "best found", the first 64 for "without '
        f'knowing"; the room is over the same starts. {processor:.0f} processor minutes of one core for all '
        f"{len(result['settings'])} settings of `results/headroom.json`, each of which says its revision. In brackets: "
        "95 % intervals."
    )
    return "\n".join([*lines, "", made(result, more)])


def optimum(part: dict[str, Any]) -> str:
    """Where it is, of a setting."""
    room, best = part["room"]["value"], part["drivers"]["best found"]["success_rate_of_searched"]
    driver, classical = part["reference"]["driver"], part["drivers"][part["classical"]["driver"]]
    learned = driver == "pretrained policy"  # measured on all starts
    above = best - (classical["success_rate"]["value"] if learned else classical["success_rate_of_searched"])
    if driver != "best found" and above > 0.1:
        word = "open" if room < 0.1 else "learned" if learned else "found"
        return f"{word}: up to {100 * above:.0f} points above"  # the optimum lies between this and the room
    return "reached" if room <= 0.03 else "above" if room >= 0.1 else "a little above"


def headroom_saved() -> str:
    """Of the manoeuvres that the search saves: how, and what decides."""
    heads = ["saved starts [%]", "the floor of 0.2 rad/s decides [%]", "FMVSS 126 to the letter [%]"]
    heads += ["sideslip beyond 0.3 rad [%]", "mean peak sideslip [rad]"]
    lines = ["| best found | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for part in read("headroom.json")["settings"].values():
        row = part["drivers"]["best found"]
        figures = row.get("of_saved", {})
        if part["level"] and "floor_decides" in figures:
            shares = [row["search_alone"], *(figures[name] for name in ("floor_decides", "fmvss", BEYOND))]
            cells = [f"{100 * share:.1f}" for share in shares]
            lines.append(
                f"| `{part['env_id']}` {part['level']} | "
                + " | ".join([*cells, f"{figures['peak_sideslip']:.3f}"])
                + " |"
            )
    return "\n".join(lines)


def mpc() -> str:
    """Model-predictive control on the hard levels, by what it is told."""
    result = read("mpc.json")
    heads = ["best classical", "MPC, told nothing", "the friction", "what the driver will do", "both"]
    told = ("nothing", "friction", "command", "friction and command")
    lines = ["| success [%] | " + " | ".join(heads) + " | ms a step |", "|---" * (len(heads) + 2) + "|"]
    for part in result["settings"].values():
        rows = part["mpc"]
        cells = [f"{percent(part['classical'])} `{part['classical']['driver'].partition(',')[0]}`"]
        cells += [percent(rows.get(what)) for what in told]
        times = [row["milliseconds_per_step"] for row in rows.values()]
        cells.append(f"{min(times):.1f} to {max(times):.1f}")
        lines.append(f"| `{part['env_id']}` {part['level']} | " + " | ".join(cells) + " |")
    horizon = ", ".join(f"{part['horizon']:g}" for part in result["settings"].values())
    row = next(iter(next(iter(result["settings"].values()))["mpc"].values()))
    more = (
        f"{row['starts']} starts, the first of those above, for all; weights the best of {row['sets']} sets on 16 "
        f"other starts; horizon {horizon} s; `results/mpc.json`. In brackets: 95 % intervals."
    )
    return "\n".join([*lines, "", made(result, more)])


def headroom_controllers() -> str:
    """Every controller of every level, shipped and tuned, and how far the restarts of its tuning are apart."""
    heads = ["success [%]", "on the road [%]", "return", "restarts, on the starts that select [%]"]
    lines = ["| level | controller | " + " | ".join(heads) + " |", "|---" * (len(heads) + 2) + "|"]
    for part in read("headroom.json")["settings"].values():
        if part["level"]:
            for driver, row in part["drivers"].items():
                if "controller" in row:
                    low, high = (100 * end for end in row.get("of_restarts", (0.0, 0.0)))
                    cells = [
                        cell(row, "success_rate", 100),
                        cell(row, "on_road_rate", 100),
                        cell(row, "episode_return"),
                    ]
                    cells.append(f"{low:.1f} to {high:.1f}" if "of_restarts" in row else "-")
                    lines.append(f"| `{part['env_id']}` {part['level']} | {driver} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def entry_speed() -> str:
    result = read("entry_speed.json")
    names = {
        "preview": "MacAdam's driver: looks 1.3 s ahead, 0.2 s late",
        "preview-tuned": "MacAdam's driver, never late, his look ahead tuned",
        "stanley": "Stanley",
        "lqr": "LQR with preview, tuned at the default speed of the first course",
        "lqr-tuned": "LQR with preview, tuned for the highest entry speed",
        "learned": "PPO (`agents.ppo`): a policy for all speeds, or of 17 m/s (iso3888-2); interquartile mean of seeds",
    }
    columns = [(course, steer) for course, modes in result["courses"].items() for steer in modes]
    heads = [f"{course}, {'front wheels' if steer == 'front' else 'both axles'}" for course, steer in columns]
    lines = ["| highest entry speed [m/s] | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for name, words in names.items():
        rows = [result["courses"][course][steer].get(name) for course, steer in columns]
        cells = [_passed(row["highest"], row["unbroken"]) + _seeds(row) if row else "-" for row in rows]
        lines.append(f"| {words} | " + " | ".join(cells) + " |")
    more = (
        f"{result['starts']} starts at each of the speeds, {result['rung']:g} m/s apart; starts from seed "
        f"{result['seed']}, tuning on others; `results/entry_speed.json`. In brackets, where it is not the same: the "
        "speed up to which every speed passes."
    )
    later = {
        row["made_by"]["command"]: row["made_by"]
        for course, steer in columns
        for row in result["courses"][course][steer].values()
        if "made_by" in row
    }
    return "\n".join(
        [*lines, "", made(result, more), *(f"Rows added by {made(one, '')[:-2]}." for one in later.values())]
    )


def _seeds(row: dict[str, Any]) -> str:
    """The range over seeds, where a row has some: its figures are then interquartile means."""
    speeds = [one["highest"] for one in row.get("seeds", [])]
    return f"; {len(speeds)} seeds, {min(speeds):.2f} to {max(speeds):.2f}" if speeds else ""


def alignment() -> str:
    result = read("alignment.json")
    heads = (
        "policies",
        "rank correlation",
        "without noise and harsher",
        "search on success [%]",
        "search on return [%]",
    )
    lines = ["| id | " + " | ".join(heads) + " | lost [points] | aligned |", "|---" * (len(heads) + 3) + "|"]
    for name, row in result["environments"].items():
        rates = [100 * one["success_rate"]["value"] for one in row["policies"]]
        cells = [
            f"{len(rates)}: {min(rates):.0f} to {max(rates):.0f} %",
            *(cell(row, key, form=".3f") for key in ("correlation", "correlation_without")),
            *(cell(row["search"][score], "success_rate", 100) for score in ("success", "return")),
            cell(row["search"], "lost", 100),
        ]
        lines.append(f"| `{name}` | " + " | ".join(cells) + f" | {row['aligned']} |")
    more = (
        f"{result['starts']} starts for every policy, {result['seconds']:.0f} s in all; `results/alignment.json`. In "
        "brackets: 95 % intervals, of the correlations over policies, of the rest over starts."
    )
    return "\n".join([*lines, "", made(result, more)])


def benchmark() -> str:
    """Every driver of every id and level on which something was trained; where learning loses stands first."""
    result, planned = read("benchmark.json"), read("mpc.json")["settings"]
    table = benchmark_tables.drivers(result["cells"].values(), read("headroom.json")["settings"], planned)
    more = (
        f"{result['starts']} starts from seed {result['seed']}, the same for all but MPC (the first 100 of them) and "
        "the searches (the first 200; without knowing the first 64). In brackets 95 % intervals: of learners, which "
        "stand with their interquartile mean, over seeds, and of the difference over seeds and starts; of all others "
        "over starts. `results/benchmark.json`, `headroom.json`, `mpc.json`, each cell with its date, machine and "
        "revision."
    )
    return "\n".join([table, "", f"`{result['command']}`; {more}"])


def trainings() -> str:
    """What the seeds of each learner came to, and what they took."""
    result = read("benchmark.json")
    hours = sum(one["seconds"] for cell in result["cells"].values() for one in cell["trainings"]) / 2.0 / 3600.0
    more = (
        f"all trainings, two at a time, are {hours:.1f} hours. Seconds of one training on one core of a machine that "
        "did other work, too, the median and the range. To the best found: until within two points of it on the "
        "learning curve, the median of the seeds that came there. "
        "`results/benchmark.json`."
    )
    return "\n".join([benchmark_tables.trainings(result["cells"].values()), "", f"`{result['command']}`; {more}"])


def cards() -> list[dict[str, Any]]:
    """What agents.robustness has found of the policies that ship."""
    return [read(path.name) for path in sorted((ROOT / "results").glob("robustness-*.json"))]


CHANGES = {
    "mass": ("mass", (0, -1)),
    "yaw_inertia": ("yaw inertia", (0, -1)),
    "stiffness": ("cornering stiffness", (0, -1)),
    "speed": ("speed", (0, -1)),
    "friction": ("friction", (0, 1, -1)),
    "action_delay": ("steps late", (2, 3, 4)),
    "noise": ("yaw rate's noise [rad/s]", (3, 4)),
}
"""Of a card, what a table shows: its words, and which of the values."""


def robustness() -> str:
    """Success of each policy that ships, and of the best classical controller, where one quantity is another."""
    found = cards()
    changes = {name: change for card in found for name, change in card["changes"].items()}
    heads = ["as it was made for"]
    for name, (words, places) in CHANGES.items():
        factor = "" if name in ("action_delay", "noise") else "x "
        heads.append(f"{words} {factor}" + ", ".join(f"{changes[name]['values'][k]:g}" for k in places))
    lines = ["| success [%] | driver | " + " | ".join(heads) + " |", "|---" * (len(heads) + 2) + "|"]
    widest = 0.0
    for card in found:
        for driver in card["policies"]:
            rates = {name: change["policies"][driver] for name, change in card["changes"].items()}
            cells = [f"{100 * rates['action_delay'][0]['success_rate']['value']:.1f}"]
            for name, (_, places) in CHANGES.items():
                rows = [rates[name][k]["success_rate"] for k in places] if name in rates else []
                cells.append(", ".join(f"{100 * row['value']:.1f}" for row in rows) or "-")
                widest = max([widest, *((row["interval"][1] - row["interval"][0]) / 2 for row in rows)])
            lines.append(f"| `{card['env_id']}` {card['level']} | {driver} | " + " | ".join(cells) + " |")
    apart = max(row["asymmetry"] for card in found for row in card["policies"].values())
    more = (
        f"{found[0]['starts']} starts from seed {found[0]['seed']}, the same for all; 95 % intervals of at most "
        f"{100 * widest:.1f} points to either side. Mirror images are answered up to {apart:.3f} of full steer apart. "
        "`results/robustness-ID-LEVEL.json`, each with its command."
    )
    words = "python -m agents.robustness --env-id ID --level LEVEL --policy pretrained classical"
    return "\n".join([*lines, "", made({**found[0], "command": words}, more)])


def margins() -> str:
    """Of who acts on the present state alone: what straight running bears."""
    heads = ["slowest mode [s]", "front wheels: gain", "phase [deg]", "rear wheels: gain", "phase [deg]"]
    heads += ["steps late that are borne", "driven: success with so many, one more [%]"]
    lines = ["| straight running | driver | " + " | ".join(heads) + " |", "|---" * (len(heads) + 2) + "|"]
    for card in cards():
        for driver, row in card["policies"].items():
            if row["at_rest"] is None:
                continue
            rest = row["at_rest"]
            place = f"| `{card['env_id']}` {card['level']} | {driver} | "
            if not rest["stable"]:
                lines.append(place + "**unstable**" + " | -" * (len(heads) - 1) + " |")
                continue
            cells = [f"{rest['slowest_time_constant']:.2f}"]
            for axle in ("front_steer_command", "rear_steer_command"):
                one = rest["margins"][axle]
                most = "any" if one["gain_increase"] is None else f"{one['gain_increase']:.1f}"
                cells.append(f"x {one['gain_decrease']:.2f} to {most}")
                cells.append("any" if one["phase"] is None else f"{one['phase'] * DEGREES:.0f}")
            late = card["changes"]["action_delay"]
            driven = dict(zip(late["values"], late["policies"][driver], strict=True))
            rows = [driven.get(rest["delay"] + k) for k in (0, 1)]  # of some steps nobody is driven
            rates = ["-" if row is None else f"{100 * row['success_rate']['value']:.1f}" for row in rows]
            cells += [str(rest["delay"]), ", ".join(rates)]
            lines.append(place + " | ".join(cells) + " |")
    return "\n".join(lines)


def summary() -> str:
    """Of each id without a level: nobody, classical, learned, and what the searches found."""
    parts, cells = read("headroom.json")["settings"], read("benchmark.json")["cells"]
    heads = ["nobody", "best classical, tuned", "PPO, one file", "evolution strategy, one file"]
    heads += ["best found without knowing", "best found"]
    lines = ["| success [%] | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for part in parts.values():
        learned = [cells.get(f"{part['env_id']} {part['level']} {name}") for name in ("native-ppo", "policy-search")]
        if part["level"] in ("medium", "hard") and any(learned):
            rows, best = part["drivers"], part["classical"]["driver"]
            row = [percent(rows["uncontrolled"]), f"{percent(rows[best])} `{best.removesuffix(', tuned')}`"]
            row += [of_seeds(one) for one in learned]
            row += [percent(rows.get("best found without knowing")), percent(rows["best found"])]
            lines.append(f"| `{part['env_id']}` {part['level']} | " + " | ".join(row) + " |")
    more = (
        "`python -m agents.headroom` and `python -m agents.benchmark`: 2000 starts, the same for all, of the searches "
        "200 or 64. In brackets 95 % intervals: of learners, whose figure is an interquartile mean, over seeds on "
        "these same starts, of all others over starts, so not to be compared with each other; the paired difference "
        "is in docs/learning.md. "
        "Dates, machines and revisions: `results/headroom.json`, `results/benchmark.json`."
    )
    return "\n".join([*lines, "", more])


def of_seeds(learned: dict[str, Any] | None) -> str:
    """Success of a learner's seeds."""
    if learned is None:
        return "-"
    return f"{cell(learned['over_seeds'], 'success_rate', 100)}, {len(learned['trainings'])} seeds"


def fast() -> str:
    """Four numbers."""
    one, many, learned = read("single_env.json"), read("vector_env.json"), read("benchmark.json")["cells"]
    rows = {row["row"]: row for row in many["ratios"]}
    tanh = rows["tanh / envpool Pendulum-v1, N = 1024"]
    alone, cart = (one["steps_per_second"][name] for name in ("BicycleStab-v0", "CartPole-v1"))
    lines = [
        "| | |",
        "|---|---|",
        f"| one car through `gym.make`, steps per second | {alone:,}, {alone / cart:.1f} times CartPole-v1 |",
        "| 1024 cars on one core, tires that saturate, steps per second "
        f"| {tanh['ours']:,}, {tanh['ratio']:.1f} times envpool's Pendulum |",
    ]
    for name in ("policy-search", "native-ppo"):
        part = learned[f"BicycleStab-v0 medium {name}"]
        took = statistics.median(one["seconds"] for one in part["trainings"])
        short = 100 * -part["better_than_classical"]["value"]
        what = f"a policy for `BicycleStab-v0`, {benchmark_tables.LEARNERS[name]}, one core"
        than = f"{short:.1f} points less than LQR, tuned; {part['machine'].partition(',')[0]}"
        lines.append(f"| {what} | {took:.0f} s; {than} |")
    words = f"`make benchmark benchmark-vector learning`, {one['date']}, {one['machine']}, where no other is said."
    return "\n".join([*lines, "", words])


def headlines() -> str:
    """Claims, each with the command that does it again; the highest entry speed is another results file's."""
    table = benchmark_tables.headlines(read("benchmark.json")["cells"].values())
    lines = [table]
    for course, steered in read("entry_speed.json")["courses"].items():
        front = steered["front"]
        if "learned" not in front:
            continue
        learned, speeds = front["learned"]["highest"], [one["highest"] for one in front["learned"]["seeds"]]
        made_by = front["learned"]["made_by"]
        seconds = made_by["seconds"] + sum(one["training"]["seconds"] for one in front["learned"]["seeds"])
        from_slow = all(one["unbroken"] > 0.0 for one in front["learned"]["seeds"])
        limits = "" if from_slow else " at its highest speed, but not from slow on: a policy for speeds near that"
        row = [
            f"{course.upper().replace('ISO', 'ISO ')}, front wheels: at least as fast as the tuned driver{limits}",
            f"{learned:.2f} m/s, {min(speeds):.2f} to {max(speeds):.2f}, {len(speeds)} seeds",
            f"{learned - front['preview-tuned']['highest']:+.2f} m/s to the driver's, "
            f"{learned - front['lqr-tuned']['highest']:+.2f} m/s to LQR's",
            "`make entry-speed-learned`",
            f"{seconds / 60.0:.0f}, {made_by['machine'].partition(',')[0]}",
        ]
        lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines)


def ablations() -> str:
    """PPO on one id with one option after the other changed."""
    return ablations_table("ablations.json")


def remedies() -> str:
    """What was tried where plain PPO fails."""
    return ablations_table("remedies.json")


HELD = ("an action for every control step", "actions are held for three steps", "only the noise is held")


def exploration() -> str:
    """What holding actions or noise is worth on every id; two of the rows are of the other plans."""
    lines = ["| success [%], medium | million steps | " + " | ".join(HELD) + " |", "|---" * (len(HELD) + 2) + "|"]
    results = {name: read(f"{name}.json") for name in ("exploration", "ablations", "remedies")}
    rows: dict[str, dict[str, Any]] = {}
    for result in results.values():
        for part in result["cells"].values():
            rows.setdefault(part["env_id"], {})[part["variant"]] = part
    drawn: list[dict[str, Any]] = []
    for env_id, parts in rows.items():
        three = [parts.get(name, parts["as it is"]) for name in HELD]  # one of them is as it is
        drawn += three
        steps = benchmark_tables.millions(three[0]["trainings"][0]["timesteps"])
        row = [cell(part["over_seeds"], "success_rate", 100) for part in three]
        lines.append(f"| `{env_id}` | {steps} | {' | '.join(row)} |")
    result = results["exploration"]
    more = (
        f"and with `--plan ablations`, `--plan remedies`; {over_seeds(drawn, result)}; `results/exploration.json`, "
        "`ablations.json`, `remedies.json`."
    )
    return "\n".join([*lines, "", made(result, more)])


def ablations_table(file: str) -> str:
    result = read(file)
    first = next(iter(result["cells"].values()))
    lines = [f"| `{first['env_id']}` {first['level']} | success [%] | of the seeds | return |", "|---|---|---|---|"]
    for part in result["cells"].values():
        low, high = (100 * end for end in part["over_seeds"]["success_rate"]["range"])
        row = [cell(part["over_seeds"], "success_rate", 100), f"{low:.1f} to {high:.1f}"]
        lines.append(f"| {part['variant']} | " + " | ".join([*row, cell(part["over_seeds"], "episode_return")]) + " |")
    more = f"{over_seeds(result['cells'].values(), result)}; `results/{file}`."
    return "\n".join([*lines, "", made(result, more)])


def over_seeds(cells: Iterable[dict[str, Any]], result: dict[str, Any]) -> str:
    """How many seeds and starts, and what stands in the columns."""
    seeds = " or ".join(str(count) for count in sorted({len(part["trainings"]) for part in cells}))
    words = f"{seeds} seeds each, {result['starts']} starts from seed {result['seed']}"
    return f"{words}; interquartile means over seeds, in brackets 95 % intervals"


def compat() -> str:
    result = read("compat.json")
    lines = ["| what was run | with | outcome |", "|---|---|---|"]
    everywhere = ("python", "bicycle-env", "numpy", "numba")
    for name, row in result["libraries"].items():
        used = ", ".join(f"{key} {value}" for key, value in row["versions"].items() if key not in everywhere)
        lines.append(f"| {name} | {used} | {row['outcome']}: {'; '.join(row['checked'])} |")
    dates = sorted({row["date"] for row in result["libraries"].values()})
    when = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
    return "\n".join([*lines, "", f"`{result['command']}`, {when}, {result['machine']}; `results/compat.json`."])


def levels() -> str:
    """Not of results: of the tasks themselves."""
    lines = ["| id | level | numbers |", "|---|---|---|"]
    for row in ENVIRONMENTS:
        task: Any = load_env_creator(row.entry_point)
        for level, numbers in task.default_task.levels.items():
            said = ", ".join(f"`{name}={_plain(value)}`" for name, value in numbers.items())
            lines.append(f"| `{row.id}` | {level} | {said or 'as without a level'} |")
    return "\n".join(lines)


def _plain(value: Any) -> str:
    """A keyword's value, numbers to four digits."""
    if isinstance(value, Actuator):
        angle, rate = (f"{limit * DEGREES:g}" for limit in (value.angle_limit, value.rate_limit))
        return f"Actuator({angle} deg, {rate} deg/s, {value.time_constant:g} s)"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key!r}: {_plain(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, tuple):
        return "(" + ", ".join(map(_plain, value)) + ")"
    return f"{value:.4g}" if isinstance(value, float) else repr(value)


def _passed(highest: float, unbroken: float) -> str:
    if highest == 0.0:
        return "none"
    return (
        f"{highest:.2f}"
        if unbroken == highest
        else f"{highest:.2f} [{unbroken:.2f}]"
        if unbroken
        else f"{highest:.2f} [none]"
    )


TABLES = {
    function.__name__: function
    for function in (
        demo,
        stab_ppo,
        lane_change_ppo,
        speed,
        vector,
        one_car,
        tensors,
        gpu,
        scaling,
        headroom,
        headroom_controllers,
        headroom_saved,
        mpc,
        entry_speed,
        controllers_stab,
        controllers_lane_change,
        compat,
        levels,
        alignment,
        benchmark,
        trainings,
        robustness,
        margins,
        summary,
        fast,
        headlines,
        exploration,
        ablations,
        remedies,
    )
}


def filled(text: str) -> str:
    """The text with every table written anew."""

    def table(match: re.Match[str]) -> str:
        return f"<!-- results: {match[1]} -->\n{TABLES[match[1]]()}\n<!-- end -->"

    return re.sub(r"<!-- results: (\w+) -->\n.*?<!-- end -->", table, text, flags=re.DOTALL)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a table is out of date")
    check, stale = parser.parse_args().check, False
    for page in PAGES:
        path = ROOT / page
        text = path.read_text(encoding="utf-8")
        new = filled(text)
        stale |= new != text
        if not check:
            path.write_text(new, encoding="utf-8")
    return int(stale and check)


if __name__ == "__main__":
    sys.exit(main())
