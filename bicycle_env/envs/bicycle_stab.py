"""BicycleStab-v0."""

from bicycle_env.envs.many.vector_env import SingleTrackVectorEnv
from bicycle_env.envs.single.single_track_env import SingleTrackEnv
from bicycle_env.tasks.stabilise import Stabilise


class BicycleStabEnv(SingleTrackEnv):
    """Catch a car that has begun to spin, and bring it back to straight running in its lane.

    ## Description

    An automobile runs at constant speed above its critical speed: straight running is unstable. At the start its body
    is turned and turning while it still travels along the lane. Left alone it is out of the lane within about a
    second, and would spin some seconds later. Both axles may be steered. The plant is the single-track ("bicycle")
    model in body-fixed coordinates (D. Karnopp, *Vehicle Stability*, ch. 6, equations 6.18-6.21) with saturating
    tires, integrated by RK4.
    Left out: braking and driving, load transfer, roll, pitch, combined slip.

    ## Action space

    `Box(-1, 1, (2,), float32)`; one entry with `steer="front"` or `steer="rear"`. Values outside saturate.

    | Num | Action | Unit | 1 means (default actuators) |
    |-----|--------|------|-----------------------------|
    | 0 | front_steer_command | of the front actuator's angle limit | 6 deg at the road wheels |
    | 1 | rear_steer_command | of the rear actuator's angle limit | 3 deg at the road wheels |

    The road wheels follow through a first-order lag (0.05 s) and a rate limit (front 40 deg/s, rear 9 deg/s).
    Positive is to the left.

    ## Observation space

    `Box(8,)` of float32: value / scale, clipped to +-bound. All entries change sign in the mirror image.

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

    Names, scales and mirror signs are `env.unwrapped.observation_names`, `.observation_scale`, `.observation_mirror`.

    ## Reward

    `reward="default"`: 1 / (1 + c), in (0, 1], with y, psi, beta, r after the step, the action u and its change du:

        c = 1.0 y^2 + 20.0 psi^2 + 20.0 beta^2 + 2.0 r^2 + 0.2 |u|^2 + 0.2 |du|^2

    `reward="quadratic"`: -(x'Qx + u'Ru), x = (lateral_position, heading, lateral_velocity, yaw_rate, front_steer,
    rear_steer) before the step, u the action; Q = diag(0.25, 10.0, 0.0, 4.0, 0.0, 0.0), R = diag(0.1, 0.1), both in
    `env.unwrapped.linear_model()`. An episode that ends before its time also pays, at its last step, the largest
    x'Qx + u'Ru that a running episode can have, times the steps that are left of `horizon`: ending early never pays.

    ## Starting state

    Uniform and independent: lateral_position in +-0.3 m, course (heading + sideslip) in +-0.01 rad, sideslip in
    +-0.3 rad, yaw_rate in +-0.8 rad/s. heading = course - sideslip, lateral_velocity = sideslip x speed; the rest is 0.

    ## Episode end

    Terminated, with the reason in `info["end"]`:

    - `"spun"`: |sideslip| > 0.8, |yaw rate| > 2.0 rad/s or |heading| > 1.2 rad;
    - `"left_lane"`: the body is wholly outside of the lane, 3.5 m wide: |lateral_position| > 1.75 m + half the body.

    Truncated after 400 steps (8 s). `info["is_success"]` is then True if, during the whole last second,
    |lateral_position| < 0.5 m, |heading| < 0.02, |sideslip| < 0.02 and |yaw rate| < 0.05 rad/s.

    ## Info

    `end` (a string), `cost` (1.0 while a corner of the body is outside of the lane, else 0.0) and `is_success`
    (running, and settled for the last second).
    {telemetry}

    ## Arguments

    | Keyword | Default | Meaning |
    |---------|---------|---------|
    {keywords}

    `reset(options={"state": {"lateral_velocity": 1.0, "yaw_rate": 0.2}})` starts from a given state; names not given
    are 0. Settable: longitudinal_position, lateral_position, heading, lateral_velocity, yaw_rate, front_steer,
    rear_steer, front_steer_command, rear_steer_command. `reset(options={"friction": 0.5})` says a number that
    `randomise` would draw, for this episode.

    `randomise` knows friction, mass, yaw_inertia, front_cornering_stiffness, rear_cornering_stiffness,
    front_time_constant and rear_time_constant. A pair is a uniform range, `(0.9, 1.2, "relative")` one per the
    nominal value; `bicycle_env.distributions` has `LogUniform`, `Normal` and `Choice` beside it. They are drawn after
    the start, which stays the same for a seed. They and the disturbances act in the equations of motion, anew in each
    RK4 step; observations, scales, limits, `speed`, `friction` and controllers are those of the nominal car. Friction
    acts where a tire saturates, so not on the linear one. An option says the number itself, in SI units, also where
    the range is relative. With a `driver` the action is the rear axle's (`steer="rear"`) or also corrects what the
    driver does (`"front"`, `"both"`); the driver is not late when `action_delay` is. The preview of the road is
    neither noisy nor late, and rewards know the truth. All stand in `env.unwrapped.state`; what `randomise` draws
    also stands in `info`.

    ## Version history

    - v0: first version.
    """

    default_task = Stabilise()


class BicycleStabVectorEnv(SingleTrackVectorEnv):
    single_class = BicycleStabEnv
