"""BicycleLaneChange-v0."""

from bicycle_env.envs.single_track_env import SingleTrackEnv
from bicycle_env.tasks.lane_change import LaneChange


class BicycleLaneChangeEnv(SingleTrackEnv):
    """doc"""

    task_class = LaneChange
