"""BicycleActiveSteer-v0."""

from bicycle_env.envs.many.vector_env import SingleTrackVectorEnv
from bicycle_env.envs.single.single_track_env import SingleTrackEnv
from bicycle_env.tasks.active_steer import ActiveSteer


class BicycleActiveSteerEnv(SingleTrackEnv):
    """Catch with the rear wheels what a driver does with the front ones."""

    default_task = ActiveSteer()


class BicycleActiveSteerVectorEnv(SingleTrackVectorEnv):
    __doc__ = f"""Many cars at once: see BicycleActiveSteerEnv for the task.

    {SingleTrackVectorEnv.__doc__}"""

    single_class = BicycleActiveSteerEnv
