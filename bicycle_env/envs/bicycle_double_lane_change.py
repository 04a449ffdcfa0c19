"""BicycleDoubleLaneChange-v0."""

from bicycle_env.envs.many.vector_env import SingleTrackVectorEnv
from bicycle_env.envs.single.single_track_env import SingleTrackEnv
from bicycle_env.tasks.double_lane_change import DoubleLaneChange


class BicycleDoubleLaneChangeEnv(SingleTrackEnv):
    """The severe double lane change between cones: into the next lane and back, as fast as it will go.

    ## Description

    The manoeuvre that road tests know, after ISO 3888-1 (`course="iso3888-1"`) and ISO 3888-2 (`"iso3888-2"`, the
    obstacle avoidance or "moose" test). After, not compliant: the numbers are those that independent implementations
    agree on, the texts were not read, and the speed is held where the second standard lets the driver lift his foot.
    The same equations as in BicycleStab-v0; by default a car that understeers, at 80 km/h on the first course and
    54 km/h on the second, both axles steered. Left out: braking and driving, load transfer, roll, pitch, combined slip.

    | course | sections 1, 2, ... [m] | lane 1 | lane 3 | lane 5 | offset |
    |--------|------------------------|--------|--------|--------|--------|
    | iso3888-1 | 15, 30, 25, 25, 15 + 15 | 1.1 w + 0.25 m | 1.2 w + 0.25 m | 1.3 w + 0.25 m | 3.5 m |
    | iso3888-2 | 12, 13.5, 11, 12.5, 12 | 1.1 w + 0.25 m | w + 1 m | 1.3 w + 0.25 m, at least 3 m | 1 m |

    w is the width of the body. The offset is that of the right edge of lane 3, from the right edge of lane 1 on the
    first course and from its left edge on the second; the right edges of the lanes 1 and 5 lie on one line. Lane 1
    begins 1 s after the start, y = 0 is its middle; the second lane lies to its left or, mirrored, to its right. Cones
    stand along the sections 1, 3 and 5 only; between them a strip 12 m wide is free. The reference path runs through
    the middles of the lanes, with quintic changes that begin and end inside the lanes: a body on it keeps 0.1 m from
    all cones. It is one way through, not the fastest: only the cones decide.

    `python -m agents.entry_speed` finds the highest speed at which a policy passes.

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

    Errors and preview are against the reference path, as in BicycleLaneChange-v0. The cones are not observed: the
    path ahead says where they are.

    ## Reward

    `reward="default"`: 1 / (1 + c), in (0, 1], with the errors e_y, e_psi and beta after the step, the action u and
    its change du:

        c = 4.0 e_y^2 + 20.0 e_psi^2 + 20.0 beta^2 + 0.0 r^2 + 0.1 |u|^2 + 0.2 |du|^2

    `reward="quadratic"`: as in BicycleStab-v0 with x = (lateral_error, heading_error, lateral_velocity, yaw_rate,
    front_steer, rear_steer), Q = diag(1.0, 10.0, 0.0, 1.0, 0.0, 0.0), R = diag(0.1, 0.1).

    ## Starting state

    Uniform and independent: lateral_position in +-0.1 m, heading in +-0.01 rad, the second lane to the left or to the
    right with equal chance; the rest is 0.

    ## Episode end

    Terminated, with the reason in `info["end"]`:

    - `"spun"`: |sideslip| > 0.8, |yaw rate| > 2.0 rad/s or |heading| > 1.2 rad;
    - `"left_course"`: a corner of the body is outside: of the cones where it is beside a lane, of the free strip where
      it is between them. Each corner is judged at its own place, at every control step; what lies between the corners
      is not.

    Truncated after 400 steps (8 s). `info["is_success"]` is then True if the whole body has passed lane 5. That
    takes at least 18.2 m/s on the first course and 9.1 m/s on the second: a slower car needs another
    `max_episode_steps`, and a faster one runs straight on, on a free road, until the time is over.

    ## Info

    `end` (a string), `cost` (1.0 while a corner of the body is outside of the corridor, else 0.0) and `is_success`
    (running, and past lane 5).
    {telemetry}

    ## Arguments

    | Keyword | Default | Meaning |
    |---------|---------|---------|
    {keywords}
    | course | `"iso3888-1"` | `"iso3888-1"` or `"iso3888-2"` |
    | direction | `"random"` | where the second lane lies: `"left"`, `"right"` or `"random"` |
    | preview_length | `1.2` | s that the preview reaches ahead; 0 for none |
    | preview_spacing | `0.1` | s between preview entries |

    `reset(options={"state": {...}, "direction": "left"})`: the state as in BicycleStab-v0, the direction for this
    episode only; of many cars, one value or one for each.

    ## Version history

    - v0: first version.
    """

    default_task = DoubleLaneChange()
    meanings = {  # noqa: RUF012 (a constant)
        "speed": "m/s; not with speed_ratio; if neither is given 22.2 on the first course, 15 on the second",
        "speed_ratio": "speed as a multiple of the vehicle's critical speed, where it has one",
    }


class BicycleDoubleLaneChangeVectorEnv(SingleTrackVectorEnv):
    single_class = BicycleDoubleLaneChangeEnv
