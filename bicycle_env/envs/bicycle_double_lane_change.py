"""BicycleDoubleLaneChange-v0; its page is the task's docstring."""

from bicycle_env.envs.many.vector_env import SingleTrackVectorEnv
from bicycle_env.envs.single.single_track_env import SingleTrackEnv
from bicycle_env.tasks.double_lane_change import DoubleLaneChange


class BicycleDoubleLaneChangeEnv(SingleTrackEnv):
    __doc__ = DoubleLaneChange.__doc__

    default_task = DoubleLaneChange()


class BicycleDoubleLaneChangeVectorEnv(SingleTrackVectorEnv):
    __doc__ = f"""Many cars at once: see BicycleDoubleLaneChangeEnv for the task.

    {SingleTrackVectorEnv.__doc__}"""

    single_class = BicycleDoubleLaneChangeEnv
