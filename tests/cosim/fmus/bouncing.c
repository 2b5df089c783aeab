/* x'' = -g - w x + b u, y = x + d u, by model exchange: where x falls to zero, the speed is turned round
   and multiplied by e. Past t = 0.5 it goes wrong in the way that `fault` says; at the time `asks` a
   completed step asks for an event, which adds 1 to `kicks`, and at the time `ends` for the end. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { U, Y, KICKS, G, W, B, D, E, X0, V0, FAULT, ASKS, ENDS, COUNT };
enum { NONE, NOT_A_NUMBER, DISCARDS, REFUSES, RESTLESS, LATE };

typedef struct {
    double v[COUNT], x[2], t;
    int asked;
} Model;

#define MODEL Model *m = c

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible,
                              fmi2Boolean logging) {
    return type == fmi2ModelExchange ? calloc(1, sizeof(Model)) : NULL;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real start,
                               fmi2Boolean d, fmi2Real stop) {
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
    MODEL;
    for (size_t i = 0; i < n; i++)
        value[i] = r[i] == Y ? m->x[0] + m->v[D] * m->v[U] : m->v[r[i]];
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
                       const fmi2Real value[]) {
    MODEL;
    for (size_t i = 0; i < n; i++) {
        m->v[r[i]] = value[i];
        if (r[i] == X0 || r[i] == V0) m->x[r[i] - X0] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    MODEL;
    m->t = time;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    MODEL;
    memcpy(m->x, x, sizeof m->x);
    return m->v[FAULT] == DISCARDS && m->t > 0.5 ? fmi2Discard : fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    MODEL;
    memcpy(x, m->x, sizeof m->x);
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    x[0] = 1.0;
    x[1] = 0.0;
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real f[], size_t n) {
    MODEL;
    const int fails = m->t > 0.5;
    f[0] = m->x[1];
    f[1] = -m->v[G] - m->v[W] * m->x[0] + m->v[B] * m->v[U];
    if (fails && m->v[FAULT] == NOT_A_NUMBER) f[1] = NAN;
    return fails && m->v[FAULT] == REFUSES ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
    MODEL;
    z[0] = m->v[E] > 0.0 ? m->x[0] : 1.0;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    MODEL;
    memset(info, 0, sizeof *info);
    if (m->v[E] > 0.0 && m->x[0] <= 0.0 && m->x[1] < 0.0) m->x[1] *= -m->v[E];
    if (m->asked == 1) {
        m->v[KICKS] += 1.0;
        m->asked = 2;
    }
    info->newDiscreteStatesNeeded = m->v[FAULT] == RESTLESS && m->t > 0.3;
    info->nextEventTimeDefined = m->v[FAULT] == LATE && m->t > 0.3;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean a, fmi2Boolean *enter,
                                       fmi2Boolean *ends) {
    MODEL;
    if (!m->asked && m->v[ASKS] > 0.0 && m->t >= m->v[ASKS]) m->asked = 1;
    *enter = m->asked == 1;
    *ends = m->v[ENDS] > 0.0 && m->t >= m->v[ENDS];
    return fmi2OK;
}

#include "rest.h"

NOTHING(fmi2EnterEventMode)
NOTHING(fmi2EnterContinuousTimeMode)
NOTHING(fmi2Terminate)

fmi2Status fmi2Reset(fmi2Component c) {
    memset(c, 0, sizeof(Model));
    return fmi2OK;
}
