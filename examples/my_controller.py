"""A controller of one's own: proportional yaw-rate feedback at the rear axle.

PYTHONPATH=examples python -m agents.evaluate --env-id BicycleStab-v0 --policy my_controller:YawDamper lqr zero
"""

import numpy as np

from bicycle_env.control import Policy


class YawDamper(Policy):
    """Steers both axles against the yaw rate, and the front one back into the lane."""

    name = "yaw-damper"

    def __init__(self, plant):
        """`plant` is the environment: what it says of its car may be used, here only where things are observed."""
        self._places = [plant.observation_names.index(name) for name in ("lateral_position", "heading", "yaw_rate")]
        self._scales = plant.observation_scale[self._places]
        self._axles = {"front": [0], "rear": [1], "both": [0, 1]}[plant.steer]

    def act(self, observation):
        y, heading, yaw_rate = np.moveaxis(observation[..., self._places] * self._scales, -1, 0)
        front, rear = -0.1 * y - 3.0 * heading - 2.0 * yaw_rate, 3.0 * yaw_rate
        action = np.stack([front, rear], axis=-1)[..., self._axles]
        return np.clip(action, -1.0, 1.0).astype(np.float32)
