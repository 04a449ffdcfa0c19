"""BicycleLaneChange-v0."""

from bicycle_env.envs.many.vector_env import SingleTrackVectorEnv
from bicycle_env.envs.single.single_track_env import SingleTrackEnv
from bicycle_env.tasks.lane_change import LaneChange


class BicycleLaneChangeEnv(SingleTrackEnv):
    """Move one lane over and settle there, at a speed at which the car is unstable by itself.

    ## Description

    The same automobile and the same equations as in BicycleStab-v0: constant speed, by default 1.2 times the critical
    speed, saturating tires, both axles steered. A path leads from the starting lane to its neighbour,

        y(s) = lane_width (10 s^3 - 15 s^4 + 6 s^5),   s = 0 ... 1 over the length of the change,

    and the car must follow it and settle. In the default 1.5 s the path's peak lateral acceleration is 9 m/s^2, close
    to what the tires can give: cutting it is part of the task. Left out: braking and driving, load transfer, roll,
    pitch, combined slip.

    ## Action space

    `Box(-1, 1, (2,), float32)`; one entry with `steer="front"` or `steer="rear"`. Values outside saturate.

    | Num | Action | Unit | 1 means (default actuators) |
    |-----|--------|------|-----------------------------|
    | 0 | front_steer_command | of the front actuator's angle limit | 6 deg at the road wheels |
    | 1 | rear_steer_command | of the rear actuator's angle limit | 3 deg at the road wheels |

    The road wheels follow through a first-order lag (0.05 s) and a rate limit (front 40 deg/s, rear 9 deg/s).
    Positive is to the left.

    ## Observation space

    `Box(22,)` of float32: value / scale, clipped to +-bound. All entries change sign in the mirror image.

    | Num | Observation | Unit | Scale | Bound |
    |-----|-------------|------|-------|-------|
    | 0 | lateral_position | m | 1 | 10 |
    | 1 | heading | rad | 0.2 | 10 |
    | 2 | lateral_velocity | m/s | 0.2 x speed | 10 |
    | 3 | yaw_rate | rad/s | 0.5 | 10 |
    | 4 | front_steer | rad | front angle limit | 1 |
    | 5 | rear_steer | rad | rear angle limit | 1 |
    | 6 | front_steer_command | rad | front angle limit | 1 |
    | 7 | rear_steer_command | rad | rear angle limit | 1 |
    | 8 | lateral_error | m | 1 | 10 |
    | 9 | heading_error | rad | 0.2 | 10 |
    | 10-21 | preview_0.1s ... preview_1.2s | m | 1 | 10 |

    Errors are against the path beside the car. A preview entry is the path's lateral position that far ahead (time x
    speed along the road) minus the car's; there are preview_length / preview_spacing of them.

    ## Reward

    `reward="default"`: 1 / (1 + c), in (0, 1], with the errors e_y, e_psi and beta after the step, the action u and
    its change du:

        c = 4.0 e_y^2 + 20.0 e_psi^2 + 20.0 beta^2 + 0.0 r^2 + 0.1 |u|^2 + 0.2 |du|^2

    `reward="quadratic"`: as in BicycleStab-v0 with x = (lateral_error, heading_error, lateral_velocity, yaw_rate,
    front_steer, rear_steer), Q = diag(1.0, 10.0, 0.0, 1.0, 0.0, 0.0), R = diag(0.1, 0.1).

    ## Starting state

    Uniform and independent: lateral_position in +-0.3 m, heading in +-0.02 rad, the change begins 0.5 to 1.5 s after
    the start, to the left or to the right with equal chance; the rest is 0.

    ## Episode end

    Terminated, with the reason in `info["end"]`:

    - `"spun"`: |sideslip| > 0.8, |yaw rate| > 2.0 rad/s or |heading| > 1.2 rad;
    - `"left_road"`: the body is wholly outside of the two lanes.

    Truncated after 300 steps (6 s). `info["is_success"]` is then True if, during the whole last second,
    the car was within 0.3 m of the new lane's middle with |heading| < 0.02, |sideslip| < 0.02 and
    |yaw rate| < 0.05 rad/s.

    ## Info

    `end` (a string), `cost` (1.0 while a corner of the body is outside of the two lanes, else 0.0) and `is_success`
    (running, and settled for the last second).
    {telemetry}

    ## Arguments

    | Keyword | Default | Meaning |
    |---------|---------|---------|
    {keywords}
    | direction | `"random"` | `"left"`, `"right"` or `"random"` |
    | change_start | `None` | s after the start at which the change begins; by default uniform in 0.5 to 1.5 |
    | duration | `None` | s that the change takes; 1.5 by default; not together with length |
    | length | `None` | m of road that the change takes |
    | lane_width | `3.5` | m |
    | preview_length | `1.2` | s that the preview reaches ahead; 0 for none |
    | preview_spacing | `0.1` | s between preview entries |

    `reset(options={"state": {...}, "direction": "left", "change_start": 1.0})`: the state as in BicycleStab-v0, the
    direction and the start of the change [s] for this episode only; of many cars, one value or one for each.

    ## Version history

    - v0: first version.
    """

    default_task = LaneChange()


class BicycleLaneChangeVectorEnv(SingleTrackVectorEnv):
    single_class = BicycleLaneChangeEnv
