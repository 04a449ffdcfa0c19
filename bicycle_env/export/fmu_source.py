"""The C of the Functional Mock-up Interface 2.0 around a plant; no header of the standard is needed."""

FMI2 = r"""
/* FMI 2.0 for co-simulation around NAME.c. Written by `bicycle-env export`. */
#include "NAME.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#ifdef FMI2_FUNCTION_PREFIX
#define JOIN_AGAIN(a, b) a##b
#define JOIN(a, b) JOIN_AGAIN(a, b)
#define FMI(name) JOIN(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif

enum { OK = 0, DISCARD = 2, ERROR = 3 };

typedef struct {
    NAME_state state;
    NAME_command command;
    NAME_car car;
    NAME_axle_forces acting;
} component;

/* By value reference. */
static const size_t places[] = {
    PLACES
};
#define COUNT (sizeof places / sizeof places[0])

static double *variable(component *self, unsigned reference)
{
    return (double *)((char *)self + places[reference]);
}

static void reset(component *self)
{
    memset(self, 0, sizeof *self);
    self->car = NAME_exported_car;
}

const char *FMI(fmi2GetTypesPlatform)(void) { return "default"; }
const char *FMI(fmi2GetVersion)(void) { return "2.0"; }
int FMI(fmi2SetDebugLogging)(void *self, int on, size_t count, const char *const categories[]) { return OK; }

void *FMI(fmi2Instantiate)(const char *name, int type, const char *guid, const char *resources, const void *functions,
                           int visible, int logging)
{
    component *self;
    if (type != 1 || guid == NULL || strcmp(guid, "GUID") != 0)
        return NULL; /* co-simulation only, and of this description only */
    self = malloc(sizeof *self);
    if (self != NULL)
        reset(self);
    return self;
}

void FMI(fmi2FreeInstance)(void *self) { free(self); }

int FMI(fmi2SetupExperiment)(void *self, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    return OK;
}

int FMI(fmi2EnterInitializationMode)(void *self) { return OK; }
int FMI(fmi2ExitInitializationMode)(void *self) { return OK; }
int FMI(fmi2Terminate)(void *self) { return OK; }

int FMI(fmi2Reset)(void *self)
{
    reset(self);
    return OK;
}

int FMI(fmi2GetReal)(void *given, const unsigned references[], size_t count, double values[])
{
    component *self = given;
    NAME_axles(&self->acting, &self->state, &self->car);
    for (size_t k = 0; k < count; k++) {
        if (references[k] >= COUNT)
            return ERROR;
        values[k] = *variable(self, references[k]);
    }
    return OK;
}

int FMI(fmi2SetReal)(void *self, const unsigned references[], size_t count, const double values[])
{
    for (size_t k = 0; k < count; k++) {
        if (references[k] >= COUNT)
            return ERROR;
        *variable(self, references[k]) = values[k];
    }
    return OK;
}

/* There are real variables only. */
int FMI(fmi2GetInteger)(void *self, const unsigned r[], size_t count, int v[]) { return count ? ERROR : OK; }
int FMI(fmi2GetBoolean)(void *self, const unsigned r[], size_t count, int v[]) { return count ? ERROR : OK; }
int FMI(fmi2GetString)(void *self, const unsigned r[], size_t count, const char *v[]) { return count ? ERROR : OK; }
int FMI(fmi2SetInteger)(void *self, const unsigned r[], size_t count, const int v[]) { return count ? ERROR : OK; }
int FMI(fmi2SetBoolean)(void *self, const unsigned r[], size_t count, const int v[]) { return count ? ERROR : OK; }
int FMI(fmi2SetString)(void *self, const unsigned r[], size_t count, const char *const v[])
{
    return count ? ERROR : OK;
}

int FMI(fmi2GetFMUstate)(void *self, void **state)
{
    if (*state == NULL)
        *state = malloc(sizeof(component));
    if (*state == NULL)
        return ERROR;
    memcpy(*state, self, sizeof(component));
    return OK;
}

int FMI(fmi2SetFMUstate)(void *self, void *state)
{
    memcpy(self, state, sizeof(component));
    return OK;
}

int FMI(fmi2FreeFMUstate)(void *self, void **state)
{
    free(*state);
    *state = NULL;
    return OK;
}

int FMI(fmi2SerializedFMUstateSize)(void *self, void *state, size_t *size)
{
    *size = sizeof(component);
    return OK;
}

int FMI(fmi2SerializeFMUstate)(void *self, void *state, char bytes[], size_t size)
{
    if (size < sizeof(component))
        return ERROR;
    memcpy(bytes, state, sizeof(component));
    return OK;
}

int FMI(fmi2DeSerializeFMUstate)(void *self, const char bytes[], size_t size, void **state)
{
    if (size < sizeof(component))
        return ERROR;
    *state = malloc(sizeof(component));
    if (*state == NULL)
        return ERROR;
    memcpy(*state, bytes, sizeof(component));
    return OK;
}

int FMI(fmi2GetDirectionalDerivative)(void *self, const unsigned unknown[], size_t unknowns, const unsigned known[],
                                      size_t knowns, const double change[], double changes[])
{
    return ERROR;
}

int FMI(fmi2SetRealInputDerivatives)(void *self, const unsigned r[], size_t count, const int order[], const double v[])
{
    return ERROR;
}

int FMI(fmi2GetRealOutputDerivatives)(void *self, const unsigned r[], size_t count, const int order[], double v[])
{
    return ERROR;
}

/* The commands are held; as many RK4 steps as are needed for none to be longer than the exported one. */
int FMI(fmi2DoStep)(void *given, double time, double step, int no_set_state)
{
    component *self = given;
    const double wanted = ceil(step / NAME_exported_timestep - 1e-9);
    const int substeps = wanted < 1.0 ? 1 : (int)wanted;
    if (!(step > 0.0 && wanted < 1e9))
        return ERROR;
    NAME_control_step(&self->state, &self->state, &self->command, &self->car, step / substeps, substeps);
    return isfinite(self->state.lateral_velocity) && isfinite(self->state.yaw_rate) ? OK : ERROR;
}

int FMI(fmi2CancelStep)(void *self) { return ERROR; }
int FMI(fmi2GetStatus)(void *self, int kind, int *value) { return DISCARD; }
int FMI(fmi2GetRealStatus)(void *self, int kind, double *value) { return DISCARD; }
int FMI(fmi2GetIntegerStatus)(void *self, int kind, int *value) { return DISCARD; }
int FMI(fmi2GetBooleanStatus)(void *self, int kind, int *value) { return DISCARD; }
int FMI(fmi2GetStringStatus)(void *self, int kind, const char **value) { return DISCARD; }
""".lstrip()
