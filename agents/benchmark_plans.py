"""What agents.benchmark trains: cells of an id, a level and a learner, by plan."""

from __future__ import annotations

from typing import NamedTuple


class Cell(NamedTuple):
    """Some seeds of a learner on an id and level."""

    env_id: str
    level: str
    learner: str
    seeds: int
    variant: str = ""
    """What is other than the settings of the id and level, in words; and as options of the trainer."""
    options: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return " ".join(filter(None, (self.env_id, self.level, self.learner, self.variant)))


ROOM = ("BicycleStab-v0", "BicycleActiveSteer-v0", "BicycleEvade-v0")
PLAN = (
    *(Cell(env_id, "medium", learner, 10) for env_id in ROOM for learner in ("native-ppo", "policy-search")),
    *(Cell(env_id, "hard", learner, 10) for env_id in ROOM for learner in ("native-ppo", "policy-search")),
    *(
        Cell(env_id, "medium", learner, 5)
        for env_id in ("BicycleLaneChange-v0", "BicycleDoubleLaneChange-v0")
        for learner in ("native-ppo", "policy-search")
    ),
    *(Cell(env_id, "medium", "sb3-ppo", 5) for env_id in ("BicycleStab-v0", "BicycleActiveSteer-v0")),
    Cell("BicycleStab-v0", "medium", "sb3-sac", 3),
)
"""In the order in which it is driven."""
VARIANTS: dict[str, tuple[str, ...]] = {
    "as it is": (),
    "an action for every control step": ("--hold", "1", "--decisions", "320"),
    "only the noise is held": ("--hold", "1", "--noise-hold", "3", "--decisions", "320"),
    "one observation": ("--history", "1"),
    "no mirror image": ("--no-mirrored",),
    "critic sees what the policy sees": ("--no-informed-critic",),
    "forfeited episodes go on": ("--no-end-forfeited",),
    "begins as rear-switched": ("--imitate", "rear-switched", "--critic-alone", "10", "--deviation", "0.1"),
    "on top of rear-switched": ("--residual", "rear-switched", "--critic-alone", "10", "--deviation", "0.1"),
}
ABLATED = ("--total-timesteps", "3000000")
"""A sixth of the usual steps: an option is worth what it brings soon, and nine of them times three seeds take long."""
FROM_NOTHING = ("--imitate", "", "--deviation", "0.37", "--critic-alone", "0", "--learning-rate", "0.001")
REMEDIES: dict[str, tuple[str, ...]] = {
    "as it is": (),
    "an action for every control step": ("--hold", "1", "--decisions", "192"),
    "only the noise is held": ("--hold", "1", "--noise-hold", "3", "--decisions", "192"),
    "from nothing": FROM_NOTHING,
    "no bonus for success": ("--success-bonus", "0"),
    "one observation": ("--history", "1"),
    "the path is planned first": ("--plan", "20"),
    "on top of evade-path": ("--imitate", "", "--residual", "evade-path"),
    "four times as many cars": ("--cars", "2048", "--critic-alone", "2"),
}
"""What was tried where plain PPO fails, on BicycleEvade-v0."""
TRIED = ("--total-timesteps", "3000000", "--critic-alone", "5")
"""A tenth of the usual steps, of which a third would be the critic's alone."""
NOT_HELD: dict[str, tuple[str, ...]] = {
    "as it is": (),
    "actions are held for three steps": ("--hold", "3"),
    "only the noise is held": ("--noise-hold", "3"),
}
HOLDING: dict[str, dict[str, tuple[str, ...]]] = {
    "BicycleStab-v0": NOT_HELD,
    "BicycleLaneChange-v0": NOT_HELD,
    "BicycleDoubleLaneChange-v0": {
        "as it is": (),
        "an action for every control step": ("--hold", "1", "--decisions", "192"),
        "only the noise is held": ("--hold", "1", "--noise-hold", "3", "--decisions", "192"),
    },
}
"""How what is tried out is held, on the ids of which the other plans do not tell it."""
HELD = {"BicycleStab-v0": "1000000", "BicycleLaneChange-v0": "1000000", "BicycleDoubleLaneChange-v0": "5000000"}
"""Control steps: a third of the usual, and as usual where less finds nothing."""
PLANS = {
    "table": PLAN,
    "ablations": tuple(
        Cell("BicycleActiveSteer-v0", "medium", "native-ppo", 3, name, (*ABLATED, *options))
        for name, options in VARIANTS.items()
    ),
    "remedies": tuple(
        Cell("BicycleEvade-v0", "medium", "native-ppo", 3, name, (*TRIED, *options))
        for name, options in REMEDIES.items()
    ),
    "exploration": tuple(
        Cell(env_id, "medium", "native-ppo", 3, name, ("--total-timesteps", HELD[env_id], *options))
        for env_id, variants in HOLDING.items()
        for name, options in variants.items()
    ),
}
