"""BicycleStab-v0."""

from bicycle_env.envs.single_track_env import SingleTrackEnv
from bicycle_env.tasks.stabilise import Stabilise


class BicycleStabEnv(SingleTrackEnv):
    """doc"""

    task_class = Stabilise
