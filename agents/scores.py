"""How good is good, for one environment and level: what `agents.headroom` has found, and scores measured with it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bicycle_env.files import listed, mapping, number_in, read_json, table, text

FILE = Path(__file__).parents[1] / "results" / "headroom.json"
LEVELS = ("easy", "medium", "hard")
RATE = number_in(0.0, 1.0)
SIDE = table({"driver": text(), "success_rate": RATE, "episode_return": number_in(-1e12, 1e12)}, others=True)
PART = table(
    {
        "classical": SIDE,
        "reference": SIDE,
        "room": table({"value": number_in(-1.0, 1.0), "interval": listed(number_in(-1.0, 1.0))}, others=True),
        "best_return": number_in(-1e12, 1e12),
    },
    others=True,
)
REACHED = 0.03
"""Room, a share of the starts, up to which the best classical controller is said to have reached the reference."""
NEAR = 0.02
"""Of success, within which a training is said to have come to the reference."""
LARGEST = 10_000_000
"""Bytes."""


class Known(NamedTuple):
    """Of an environment and level: the best classical controller tuned for it, and what stands above it."""

    classical: str
    classical_success: float
    reference: str
    reference_success: float
    """Of the best found; where something is hidden, of the best found without knowing it: the classical controller's on
    the starts that report and the room, which is one of the starts that the searches drove."""
    room_interval: tuple[float, float]
    best_return: float
    """The mean over starts of the largest return that anyone had there."""

    @property
    def room(self) -> float:
        """A share of the starts."""
        return self.reference_success - self.classical_success

    @property
    def has_score(self) -> bool:
        """Whether there is room for one."""
        return self.room > REACHED

    def score(self, success_rate: float) -> float | None:
        """0 as good as the best classical controller, 1 as the reference; None where no room is between them."""
        return (success_rate - self.classical_success) / self.room if self.has_score else None

    def regret(self, episode_return: float) -> float:
        """How much return is missing to the best known."""
        return self.best_return - episode_return

    def seconds_to_reference(self, curve: Iterable[Sequence[float]]) -> float | None:
        """When a learning curve, rows of steps, seconds and success, first comes within NEAR; None if it does not."""
        near = (seconds for _, seconds, success in curve if success >= self.reference_success - NEAR)
        return next(near, None)


def known(env: Any, path: Path = FILE) -> Known | None:
    """What is known about an environment that has been reset; None where it is of no level, or nothing is on disk.

    Raises:
        FileError: the file is damaged.
    """
    plant = env.unwrapped
    if plant.spec is None or plant.scored_level is None:
        return None
    return known_of(plant.spec.id, plant.scored_level, path)


def known_of(env_id: str, level: str, path: Path = FILE) -> Known | None:
    """The same, by the id and the level."""
    part = part_of(env_id, level, path)
    if part is None:
        return None
    driver, reference, room = part["classical"]["driver"], part["reference"], part["room"]
    # The searched starts may be harder than all those that report: the room is theirs, the zero of all.
    of_all = part.get("drivers", {}).get(driver, part["classical"])["success_rate"]
    zero = of_all["value"] if isinstance(of_all, dict) else of_all
    low, high = room["interval"]
    return Known(driver, zero, reference["driver"], zero + room["value"], (low, high), part["best_return"])


def part_of(env_id: str, level: str, path: Path = FILE) -> dict[str, Any] | None:
    """All that the file holds of a level; None where there is none.

    Raises:
        FileError: the file is damaged.
    """
    if not path.is_file():
        return None
    settings = read_json(path, table({"settings": mapping(PART)}, others=True), largest=LARGEST)["settings"]
    found: dict[str, Any] | None = settings.get(f"{env_id} {level}")
    return found


def tuned(env_id: str, level: str | None, controller: str, path: Path = FILE) -> dict[str, float] | None:
    """The parameters of a controller that were tuned for a level; None where there are none."""
    part = None if level is None else part_of(env_id, level, path)
    row = {} if part is None else part.get("drivers", {}).get(f"{controller}, tuned", {})
    return row.get("parameters")


def scored(found: Known, rows: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, float | None]]:
    """Score and regret of each row of figures."""
    return {
        name: {
            "score": found.score(row["success_rate"]["value"]),
            "regret": found.regret(row["episode_return"]["value"]),
        }
        for name, row in rows.items()
    }


def sentences(found: Known, rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """For people, to stand below a table of these rows."""
    classical = f"{found.classical}, saves {100 * found.classical_success:.1f} % of 2000 starts"
    above = f"{found.reference}, {100 * found.room:.1f} points more on those that were searched"
    figures = scored(found, rows)
    if found.has_score:
        told = ", ".join(f"{name} {row['score']:.2f}{_between(found, rows[name])}" for name, row in figures.items())
        lines = [f"score: {told} (0: {classical}; 1: {above})"]
    else:
        why = (
            "nothing even three points better was found without knowing what is hidden"
            if "without" in found.reference
            else "as far as a search knows it, the optimum is reached: none found three points more than classical "
            "control"
        )
        lines = [f"no score: {why} ({classical}; {above})"]
    told = ", ".join(f"{name} {row['regret']:.2f}" for name, row in figures.items())
    return [*lines, f"regret in return: {told} (best known {found.best_return:.2f}; results/headroom.json)"]


def _between(found: Known, row: Mapping[str, Any]) -> str:
    """The interval of a row's score, of its success alone: few starts say little."""
    ends = row["success_rate"].get("interval")
    return "" if ends is None else " [{:.2f}, {:.2f}]".format(*(found.score(end) for end in ends))
