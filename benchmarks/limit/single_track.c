/* One control step of BicycleStab-v0 for many cars, in C: what the compiled Python is measured against.

   The same blocks in memory, the same equations, the same five RK4 substeps, end, cost, reward and observation as
   bicycle_env/envs/many/block_kernels.py; the columns of a block and the shared numbers are in its order. The linear tire
   (small angles) uses the package's polynomials for sine and cosine; the saturating tires (exact geometry) call libm,
   which gcc replaces by the vector functions of libmvec. Build lines: benchmarks/limit/build.py.

   -DTIRE_LINEAR | -DTIRE_TANH | -DTIRE_FIALA | -DTIRE_MAGIC_FORMULA, -DREAL=double|float (with float: -DSINGLE), -DROWS=rows a block,
   -DLATERAL_WEIGHT=1.0 and so on: what the laws hold as constants. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "layout.h" /* written by build.py from the Python tuples: COLUMN_..., NUMBER_..., and how many there are */

#ifndef REAL
#define REAL double
#endif
#ifndef ROWS
#define ROWS 64
#endif

/* a b + c, rounded once, where the laws say xp.multiply_add. */
#ifdef SINGLE
#define ADD(a, b, c) __builtin_fmaf(a, b, c)
#else
#define ADD(a, b, c) __builtin_fma(a, b, c)
#endif

static inline REAL least(REAL a, REAL b) { return a < b ? a : b; }
static inline REAL most(REAL a, REAL b) { return a > b ? a : b; }

#ifdef TIRE_LINEAR
static inline REAL near_sine(REAL r) {
    REAL z = r * r, z2 = z * z;
    REAL low = ADD(z2, ADD(z, 2.7557319219115013e-06, -0.00019841269841254795), ADD(z, 0.008333333333333316, -0.16666666666666666));
    REAL high = ADD(z2, ADD(z, 2.7312868913092307e-15, -7.643957622560617e-13), ADD(z, 1.6058976915095007e-10, -2.505210761086116e-08));
    return ADD(r * z, ADD(z2 * z2, high, low), r);
}
static inline REAL near_cosine(REAL r) {
    REAL z = r * r, z2 = z * z;
    REAL low = ADD(z2, ADD(z, -2.755731856817136e-07, 2.4801587298886815e-05), ADD(z, -0.0013888888888884717, 0.04166666666666666));
    REAL high = ADD(z2, 4.646173408703228e-14, ADD(z, -1.1466234424282487e-11, 2.0876681108263528e-09));
    return ADD(z2, ADD(z2 * z2, high, low), ADD(-0.5, z, 1.0));
}
static inline REAL half_turns(REAL size) { return floor(ADD(size, 1.0 / M_PI, 0.5)); }
static inline REAL reduced(REAL size, REAL n) {
    return ADD(n, -4.044532497591901e-21, ADD(n, -1.2154201012607932e-10, ADD(n, -3.1415926534682512, size)));
}
static inline REAL sign(REAL n) { return 1.0 - 2.0 * (n - 2.0 * floor(0.5 * n)); }
static inline REAL sine(REAL x) {
    REAL n = half_turns(fabs(x)), s = sign(n) * near_sine(reduced(fabs(x), n));
    return x < 0.0 ? -s : s;
}
static inline REAL cosine(REAL x) {
    REAL n = half_turns(fabs(x));
    return sign(n) * near_cosine(reduced(fabs(x), n));
}
#define SLIP(velocity, per_speed, steer) ADD(velocity, per_speed, -(steer))
#define STEERED(x) ((REAL)1.0)
#define FORCE(slip, stiffness, peak) (-(stiffness) * (slip))
#else
/* Under names of our own gcc does not merge sin and cos of one angle into a call that libmvec does not have. */
#define SIMD __attribute__((simd("notinbranch"), const))
#define VECTOR2(ours, name) extern REAL ours(REAL) __asm__(#name) SIMD;
#define VECTOR(ours, name) VECTOR2(ours, name)
#ifdef SINGLE
VECTOR(sine, sinf) VECTOR(cosine, cosf) VECTOR(tangent, tanf) VECTOR(arctangent, atanf) VECTOR(hyperbolic, tanhf)
#else
VECTOR(sine, sin) VECTOR(cosine, cos) VECTOR(tangent, tan) VECTOR(arctangent, atan) VECTOR(hyperbolic, tanh)
#endif
#define SLIP(velocity, per_speed, steer) (arctangent((velocity) * (per_speed)) - (steer))
#define STEERED(x) cosine(x)
#ifdef TIRE_TANH
static inline REAL force(REAL slip, REAL stiffness, REAL peak) { return -peak * hyperbolic(slip * (stiffness / peak)); }
#elif defined(TIRE_FIALA)
static inline REAL force(REAL slip, REAL stiffness, REAL peak) {
    REAL sliding = arctangent(3.0 * peak / stiffness);
    REAL z = least(tangent(least(fabs(slip), sliding)) * (stiffness / (3.0 * peak)), 1.0);
    REAL y = peak * (z * ADD(-z, 3.0 - z, 3.0));
    return slip > 0.0 ? -y : y;
}
#else
static inline REAL force(REAL slip, REAL stiffness, REAL peak) {
    REAL x = slip * (stiffness / (1.3 * peak));
    return -peak * sine(1.3 * arctangent(ADD(1.0, x - arctangent(x), x)));
}
#endif
#define FORCE(slip, stiffness, peak) force(slip, stiffness, peak)
#endif

typedef struct { REAL x, y, heading, v, r, front, rear; } State;

static inline State rates(State s, REAL front_command, REAL rear_command, const REAL *w) {
    REAL per_speed = 1.0 / w[NUMBER_SPEED];
    REAL front_slip = SLIP(ADD(w[NUMBER_CG_TO_FRONT], s.r, s.v), per_speed, s.front);
    REAL rear_slip = SLIP(ADD(-w[NUMBER_CG_TO_REAR], s.r, s.v), per_speed, s.rear);
    REAL yf = FORCE(front_slip, w[NUMBER_FRONT_CORNERING_STIFFNESS], w[NUMBER_FRONT_PEAK_FORCE]) * STEERED(s.front);
    REAL yr = FORCE(rear_slip, w[NUMBER_REAR_CORNERING_STIFFNESS], w[NUMBER_REAR_PEAK_FORCE]) * STEERED(s.rear);
    State d;
#ifdef TIRE_LINEAR
    d.x = w[NUMBER_SPEED];
    d.y = ADD(w[NUMBER_SPEED], s.heading, s.v);
#else
    REAL si = sine(s.heading), co = cosine(s.heading);
    d.x = ADD(w[NUMBER_SPEED], co, -s.v * si);
    d.y = ADD(w[NUMBER_SPEED], si, s.v * co);
#endif
    d.heading = s.r;
    d.v = ADD(-s.r, w[NUMBER_SPEED], (yf + yr) * (1.0 / w[NUMBER_MASS]));
    d.r = ADD(yf, w[NUMBER_CG_TO_FRONT] * (1.0 / w[NUMBER_YAW_INERTIA]), -yr * (w[NUMBER_CG_TO_REAR] * (1.0 / w[NUMBER_YAW_INERTIA])));
    d.front = most(least((front_command - s.front) * (1.0 / w[NUMBER_FRONT_TIME_CONSTANT]), w[NUMBER_FRONT_RATE_LIMIT]), -w[NUMBER_FRONT_RATE_LIMIT]);
    d.rear = most(least((rear_command - s.rear) * (1.0 / w[NUMBER_REAR_TIME_CONSTANT]), w[NUMBER_REAR_RATE_LIMIT]), -w[NUMBER_REAR_RATE_LIMIT]);
    return d;
}

static inline State moved(State s, State d, REAL t) {
    return (State){ADD(t, d.x, s.x), ADD(t, d.y, s.y), ADD(t, d.heading, s.heading), ADD(t, d.v, s.v), ADD(t, d.r, s.r),
                   ADD(t, d.front, s.front), ADD(t, d.rear, s.rear)};
}

#define SUM(name) ADD((REAL)2.0, k2.name + k3.name, k1.name) + k4.name
static inline State six_times_mean(State k1, State k2, State k3, State k4) {
    return (State){SUM(x), SUM(y), SUM(heading), SUM(v), SUM(r), SUM(front), SUM(rear)};
}

long step(REAL *numbers, const float *actions, const uint64_t *generators, float *observation, double *values, uint8_t *flags,
          int8_t *end, long cars, long axles, long restarts, long first, long last) {
    (void)generators, (void)restarts; /* it only steps: an episode that has ended goes on */
    REAL w[NUMBERS], *rows = numbers + NUMBERS;
    memcpy(w, numbers, sizeof w);
    const REAL h = w[NUMBER_CONTROL_TIMESTEP] / w[NUMBER_SUBSTEPS];
    const REAL per_speed = 1.0 / w[NUMBER_SPEED], per_front = 1.0 / w[NUMBER_FRONT_ANGLE_LIMIT], per_rear = 1.0 / w[NUMBER_REAR_ANGLE_LIMIT];
    const int substeps = (int)w[NUMBER_SUBSTEPS];
    for (long row = first * ROWS; row < (last * ROWS < cars ? last * ROWS : cars); row++)
        for (long j = 0; j < axles; j++)
            if (!__builtin_isfinite(actions[row * axles + j])) return -1;
    long ended = 0;
    for (long block = first; block < last; block++) {
        REAL c[COLUMNS][ROWS], front[ROWS], rear[ROWS], front_command[ROWS], rear_command[ROWS];
        REAL reward[ROWS], cost[ROWS];
        float seen[ENTRIES][ROWS];
        const long row = block * ROWS;
        const int here = cars - row < ROWS ? (int)(cars - row) : ROWS;
        memcpy(c, rows + block * COLUMNS * ROWS, sizeof c);
        memset(front, 0, sizeof front);
        memset(rear, 0, sizeof rear);
        for (int k = 0; k < here; k++) {
            front[k] = actions[(row + k) * axles];
            rear[k] = actions[(row + k) * axles + axles - 1];
        }
        for (int k = 0; k < ROWS; k++) {
            front[k] = most(least(front[k], 1.0), -1.0) * w[NUMBER_STEERS_FRONT];
            rear[k] = most(least(rear[k], 1.0), -1.0) * w[NUMBER_STEERS_REAR];
            front_command[k] = front[k] * w[NUMBER_FRONT_ANGLE_LIMIT];
            rear_command[k] = rear[k] * w[NUMBER_REAR_ANGLE_LIMIT];
        }
        for (int substep = 0; substep < substeps; substep++)
            for (int k = 0; k < ROWS; k++) {
                State s = {c[COLUMN_LONGITUDINAL_POSITION][k], c[COLUMN_LATERAL_POSITION][k], c[COLUMN_HEADING][k], c[COLUMN_LATERAL_VELOCITY][k], c[COLUMN_YAW_RATE][k], c[COLUMN_FRONT_STEER][k], c[COLUMN_REAR_STEER][k]};
                State k1 = rates(s, front_command[k], rear_command[k], w);
                State k2 = rates(moved(s, k1, 0.5 * h), front_command[k], rear_command[k], w);
                State k3 = rates(moved(s, k2, 0.5 * h), front_command[k], rear_command[k], w);
                State k4 = rates(moved(s, k3, h), front_command[k], rear_command[k], w);
                s = moved(s, six_times_mean(k1, k2, k3, k4), h / 6.0);
                c[COLUMN_LONGITUDINAL_POSITION][k] = s.x; c[COLUMN_LATERAL_POSITION][k] = s.y; c[COLUMN_HEADING][k] = s.heading; c[COLUMN_LATERAL_VELOCITY][k] = s.v; c[COLUMN_YAW_RATE][k] = s.r;
                c[COLUMN_FRONT_STEER][k] = s.front; c[COLUMN_REAR_STEER][k] = s.rear;
            }
        for (int k = 0; k < ROWS; k++) {
            REAL y = c[COLUMN_LATERAL_POSITION][k], heading = c[COLUMN_HEADING][k], v = c[COLUMN_LATERAL_VELOCITY][k], r = c[COLUMN_YAW_RATE][k];
            int spun = (fabs(v) > (REAL)SIDESLIP_LIMIT * w[NUMBER_SPEED]) | (fabs(r) > (REAL)YAW_RATE_LIMIT)
                     | (fabs(heading) > (REAL)HEADING_LIMIT);
            int left = fabs(y) > ADD(0.5, w[NUMBER_BODY_WIDTH], (REAL)ROAD_HALF_WIDTH);
            c[COLUMN_END][k] = spun ? 1.0 : left ? 2.0 : 0.0;
            REAL s = sine(heading);
            REAL reach = ADD(0.5 * w[NUMBER_BODY_WIDTH], fabs(cosine(heading)),
                             most(fabs(ADD(w[NUMBER_FRONT_EXTENT], s, y)), fabs(ADD(-w[NUMBER_REAR_EXTENT], s, y))));
            cost[k] = reach > (REAL)ROAD_HALF_WIDTH ? 1.0 : 0.0;
            REAL sideslip = v * per_speed;
            REAL df = ADD(-c[COLUMN_FRONT_STEER_COMMAND][k], per_front, front[k]);
            REAL dr = ADD(-c[COLUMN_REAR_STEER_COMMAND][k], per_rear, rear[k]);
            REAL total = ADD((REAL)LATERAL_WEIGHT, y * y, 1.0);
            total = ADD((REAL)HEADING_WEIGHT, heading * heading, total);
            total = ADD((REAL)SIDESLIP_WEIGHT, sideslip * sideslip, total);
            total = ADD((REAL)YAW_RATE_WEIGHT, r * r, total);
            total = ADD((REAL)EFFORT_WEIGHT, front[k] * front[k], total);
            total = ADD((REAL)EFFORT_WEIGHT, rear[k] * rear[k], total);
            total = ADD((REAL)SMOOTHNESS_WEIGHT, df * df, total);
            total = ADD((REAL)SMOOTHNESS_WEIGHT, dr * dr, total);
            reward[k] = 1.0 / total;
            int settled = (fabs(y) < (REAL)LATERAL_TOLERANCE) & (fabs(heading) < (REAL)HEADING_TOLERANCE)
                        & (fabs(v) < (REAL)SIDESLIP_TOLERANCE * w[NUMBER_SPEED]) & (fabs(r) < (REAL)YAW_RATE_TOLERANCE);
            c[COLUMN_SETTLED_STEPS][k] = settled ? c[COLUMN_SETTLED_STEPS][k] + 1.0 : 0.0;
            c[COLUMN_STEPS][k] += 1.0;
            c[COLUMN_FRONT_STEER_COMMAND][k] = front_command[k];
            c[COLUMN_REAR_STEER_COMMAND][k] = rear_command[k];
        }
        static const int shown[ENTRIES] = {COLUMN_LATERAL_POSITION, COLUMN_HEADING, COLUMN_LATERAL_VELOCITY, COLUMN_YAW_RATE, COLUMN_FRONT_STEER, COLUMN_REAR_STEER, COLUMN_FRONT_STEER_COMMAND, COLUMN_REAR_STEER_COMMAND};
        for (int j = 0; j < ENTRIES; j++) {
            const float bound = w[NUMBER_BOUND + j];
            for (int k = 0; k < ROWS; k++) {
                float value = c[shown[j]][k] * w[NUMBER_PER_SCALE + j];
                value = value > -bound ? value : -bound;
                seen[j][k] = value < bound ? value : bound;
            }
        }
        memcpy(rows + block * COLUMNS * ROWS, c, sizeof c);
        for (int k = 0; k < here; k++) {
            const int late = c[COLUMN_STEPS][k] >= w[NUMBER_STEP_LIMIT], over = c[COLUMN_END][k] > 0.0;
            values[row + k] = reward[k];
            values[cars + row + k] = cost[k];
            end[row + k] = (int8_t)c[COLUMN_END][k];
            flags[row + k] = over;
            flags[cars + row + k] = late;
            flags[2 * cars + row + k] = !over & (c[COLUMN_SETTLED_STEPS][k] >= w[NUMBER_STEPS_TO_SETTLE]);
            ended += over | late;
            for (int j = 0; j < ENTRIES; j++) observation[(row + k) * ENTRIES + j] = seen[j][k];
        }
    }
    return ended;
}
