"""BicycleActiveSteer-v0."""

from bicycle_env.envs.many.vector_env import SingleTrackVectorEnv
from bicycle_env.envs.single.single_track_env import SingleTrackEnv
from bicycle_env.tasks.active_steer import ActiveSteer


class BicycleActiveSteerEnv(SingleTrackEnv):
    """A driver turns the front wheels suddenly, left and right: keep the car from spinning with the rear wheels.

    ## Description

    The same automobile and the same equations as in BicycleStab-v0: constant speed, an oversteering car by default,
    saturating tires. Someone else has the steering wheel: 0.5 s after the start the front wheels begin a sine with
    dwell, the manoeuvre of FMVSS 126, first to the left or to the right; one period, held for a while at its second
    peak. With straight rear wheels the car spins or goes on turning. The action steers the rear wheels, so that the car
    goes where it was sent and its yaw rate dies out when the driver is through. Speed, friction and the driver's
    amplitude are drawn anew for each episode; friction and amplitude are hidden. Speeds are relative to the nominal
    one, which is 1.2 times the critical speed unless given: by default all episodes are above the critical speed.
    Left out: braking and driving, load transfer, roll, pitch, combined slip.

    ## Action space

    `Box(-1, 1, (1,), float32)`; two entries with `steer="both"`: then the first one is added to what the driver does at
    the front. Values outside saturate.

    | Num | Action | Unit | 1 means (default actuators) |
    |-----|--------|------|-----------------------------|
    | 0 | rear_steer_command | of the rear actuator's angle limit | 3 deg at the road wheels |

    The road wheels follow through a first-order lag (0.05 s) and a rate limit (front 40 deg/s, rear 9 deg/s).
    Positive is to the left.

    ## Observation space

    `Box(10,)` of float32: value / scale, clipped to +-bound. What a car measures; `observed="state"` adds sideslip. All
    entries change sign in the mirror image, but for speed, peak_yaw_rate and driver_finished.

    | Num | Observation | Unit | Scale | Bound |
    |-----|-------------|------|-------|-------|
    | 0 | yaw_rate | rad/s | 0.5 | 10 |
    | 1 | lateral_acceleration | m/s^2 | 10 | 10 |
    | 2 | front_steer | rad | front angle limit | 1 |
    | 3 | rear_steer | rad | rear angle limit | 1 |
    | 4 | driver_command | rad | front angle limit | 1 |
    | 5 | speed | m/s | speed | 10 |
    | 6 | front_correction | rad | front angle limit | 1 |
    | 7 | rear_steer_command | rad | rear angle limit | 1 |
    | 8 | peak_yaw_rate | rad/s | 0.5 | 10 |
    | 9 | driver_finished |  | 1 | 1 |

    The lateral acceleration is the mean over the last control step. The driver's command is the one of the step that
    comes, speed the true one (its scale the nominal one), front_correction and rear_steer_command are the last action;
    by peak_yaw_rate, and from driver_finished on, success is judged. `history=6` shows the latest six observations,
    `sensors=` makes them noisy: `{"noise": {"lateral_acceleration": 0.2, "yaw_rate": 0.01}}`.

    ## Reward

    `reward="default"`: 0.1 / (1 + c), with the yaw rate r, the sideslip beta, the action's change du, and `after`
    rising from 0 to 1 in the 0.5 s after the driver:

        c = 30.0 (r - r_ref)^2 + 60.0 max(0, |beta| - 0.05)^2 + 0.05 |du|^2 + after 100.0 (r^2 + beta^2)
        r_ref = (U / L) d / (1 + 0.0015 U^2), within +-0.85 friction g / U

    with the true speed and friction, d what the driver alone has made of the front wheels. A spin, a yaw rate that was
    too large and a displacement that was too small cost 30.0 each, once. At the time-out nothing is added.

    `reward="quadratic"`: as in BicycleStab-v0 with x = (lateral_position, heading, lateral_velocity, yaw_rate,
    front_steer, rear_steer), Q = diag(0.0, 0.1, 0.01, 10.0, 0.0, 0.0), R = diag(0.1).

    ## Starting state

    Straight running. Uniform and independent: speed 0.88 to 1.0 of the nominal one, friction 0.5 to 1.0 of the nominal
    one, amplitude 0.0175 to 0.0873 rad at the road wheels; frequency 0.7 Hz and dwell 0.5 s, or of a range. The first
    direction is left or right with equal chance.

    ## Episode end

    Terminated, with the reason in `info["end"]`:

    - `"spun"`: |sideslip| > 0.8, |yaw rate| > 2.0 rad/s or |heading| > 1.5 rad;
    - `"left_area"`: 100.0 m to the side.

    Truncated after 300 steps (6 s). `env.unwrapped.is_success` is then True if

    - |yaw rate| was at most 0.35 of its peak at the control step 1.0 s after the driver had finished, and at most 0.2
      of it from 1.75 s after it to the end. The peak is the largest |yaw rate| since 0.375 periods after the
      beginning, and counts at least 0.2 rad/s: the bare ratios would reward a large peak;
    - the displacement to the driver's side 1.07 s after the beginning was at least 0.8 of the one that the same car has
      with straight rear wheels (`env.unwrapped.state.twin_lateral_position`), where that is positive.

    The figures of FMVSS 126 to the letter are among the metrics, without floor and with its 1.83 m.

    ## Info

    `end` (a string), `cost` (1.0 while a corner of the body is outside of the area, else 0.0), `is_success` (so far).
    {telemetry}

    ## Arguments

    | Keyword | Default | Meaning |
    |---------|---------|---------|
    {keywords}
    | direction | `"random"` | to which the driver turns first: `"left"`, `"right"` or `"random"` |
    | relative_speed | `(0.88, 1.0)` | range of the true speed, per the nominal one |
    | relative_friction | `(0.5, 1.0)` | range of the true friction, per the nominal one |
    | amplitude | `(0.0175, 0.0873)` | range, rad at the road wheels |
    | frequency | `(0.7, 0.7)` | range, Hz |
    | dwell | `(0.5, 0.5)` | range, s at the second peak |
    | observed | `"measured"` | `"measured"`, or `"state"` for sideslip, too |

    With `driver=` that driver takes the place of the sine with dwell, and there is no success.
    `reset(options={"state": {...}, "direction": "left", "relative_speed": 0.9, "relative_friction": 0.6,
    "amplitude": 0.05, "frequency": 0.7, "dwell": 0.5})`: what is not given is drawn; of many cars, one value or one
    for each.

    ## Version history

    - v0: first version.
    """

    default_task = ActiveSteer()


class BicycleActiveSteerVectorEnv(SingleTrackVectorEnv):
    single_class = BicycleActiveSteerEnv
