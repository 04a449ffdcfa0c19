"""BicycleEvade-v0."""

from bicycle_env.envs.many.vector_env import SingleTrackVectorEnv
from bicycle_env.envs.single.single_track_env import SingleTrackEnv
from bicycle_env.tasks.evade import Evade


class BicycleEvadeEnv(SingleTrackEnv):
    """An obstacle blocks the lane: go round it through the next lane, come back, and run straight.

    ## Description

    The same automobile and the same equations as in BicycleStab-v0: constant speed, by default 1.2 times the critical
    speed, saturating tires. Only the front wheels are steered, the friction is hidden, and no path is given: where to
    go, and how sharply, is to be planned. Two lanes are 3.5 m wide each, the own one around y = 0 and the other to its
    left or, mirrored, to its right. Three gates lie along the road; where they are is drawn in seconds, for the front
    bumper at the car's speed:

    | from | until | free |
    |------|-------|------|
    | the start | the obstacle, 0.9 to 1.6 s | both lanes |
    | there | its end, 0.3 to 0.6 s | the other lane |
    | there | the last gate, 0.9 to 1.6 s | both lanes |
    | there | for ever | the own lane |

    The free corridor is judged at every control step at 5 points along each side of the body, each at its own place.
    One point outside forfeits success; the car drives on. Left out: braking and driving, load transfer, roll, pitch,
    combined slip.

    ## Action space

    `Box(-1, 1, (1,), float32)`; two entries with `steer="both"`. Values outside saturate.

    | Num | Action | Unit | 1 means (default actuators) |
    |-----|--------|------|-----------------------------|
    | 0 | front_steer_command | of the front actuator's angle limit | 6 deg at the road wheels |

    The road wheels follow through a first-order lag (0.05 s) and a rate limit (front 40 deg/s, rear 9 deg/s).
    Positive is to the left.

    ## Observation space

    `Box(14,)` of float32: value / scale, clipped to +-bound. All entries change sign in the mirror image, but for
    speed, obstacle_begin, obstacle_end, last_gate and touched.

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
    | 8 | speed | m/s | 40 | 10 |
    | 9 | side |  | 1 | 1 |
    | 10 | obstacle_begin | m | speed | 5 |
    | 11 | obstacle_end | m | speed | 5 |
    | 12 | last_gate | m | speed | 5 |
    | 13 | touched |  | 1 | 1 |

    Lateral position counts from the own lane's middle. The gates are distances along the road from the front bumper,
    negative behind it. side is that of the other lane, 1 left and -1 right; touched is 1 once a point was outside.

    ## Reward

    `reward="default"`: 1 / (1 + c), in (0, 1], and 0.1 of it after a touch; with the clearance d (from the corridor's
    edge to the nearest point), the sideslip beta and yaw rate r after the step, the action u and its change du:

        c = 10.0 max(0, 0.2 - d)^2 + 10.0 beta^2 + 0.2 r^2 + 0.05 |u|^2 + 0.02 |du|^2

    Once the whole body is behind the last gate, 2000.0 (psi^2 + beta^2 + 0.25 r^2) more.

    `reward="quadratic"`: as in BicycleStab-v0 with x = (lateral_position, heading, lateral_velocity, yaw_rate,
    front_steer, rear_steer), Q = diag(0.5, 10.0, 0.0, 1.0, 0.0, 0.0), R = diag(0.1); the lateral position counts from
    the middle of the other lane beside the obstacle, else of the own one.

    ## Starting state

    Uniform and independent: lateral_position in +-0.2 m, heading in +-0.01 rad, sideslip in +-0.005 rad, yaw_rate in
    +-0.03 rad/s, friction 0.3 to 1.0 of the nominal one, the gates as above; the other lane to the left or to the
    right with equal chance. The rest is 0.

    ## Episode end

    Terminated, with the reason in `info["end"]`:

    - `"spun"`: |sideslip| > 0.8, |yaw rate| > 2.0 rad/s or |heading| > 1.2 rad;
    - `"left_corridor"`: a point of the body is more than 2.5 m outside.

    Truncated after 340 steps (6.8 s). `info["is_success"]` is then True if no point was ever outside and, during the
    whole last 0.5 s, |heading| < 0.05, |sideslip| < 0.05 and |yaw rate| < 0.1 rad/s.

    ## Info

    `end` (a string), `cost` (1.0 while a point of the body is outside of the corridor, else 0.0) and `is_success`
    (running, never outside, and settled for the last 0.5 s).
    {telemetry}

    ## Arguments

    | Keyword | Default | Meaning |
    |---------|---------|---------|
    {keywords}
    | direction | `"random"` | where the other lane is: `"left"`, `"right"` or `"random"` |
    | relative_friction | `(0.3, 1.0)` | range of the true friction, per the nominal one |
    | obstacle_time | `(0.9, 1.6)` | range, s from the start to the obstacle |
    | obstacle_length | `(0.3, 0.6)` | range, s along the obstacle |
    | return_time | `(0.9, 1.6)` | range, s from the obstacle's end to the last gate |

    `reset(options={"state": {...}, "direction": "left", "relative_friction": 0.6, "obstacle_time": 1.2,
    "obstacle_length": 0.6, "return_time": 1.5})`: what is not given is drawn; of many cars, one value or one for each.

    ## Version history

    - v0: first version.
    """

    default_task = Evade()


class BicycleEvadeVectorEnv(SingleTrackVectorEnv):
    single_class = BicycleEvadeEnv
