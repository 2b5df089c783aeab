/* y jumps from 0 to 1 at the time that next_event announces, by a comparison with a margin, as is usual
   in C: it has jumped so much earlier. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { Y, NEXT_EVENT, AT, MARGIN, COUNT };

typedef struct {
    double v[COUNT], t;
} Model;

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real length, fmi2Boolean final) {
    ((Model *)c)->t = time + length;
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
    const Model *m = c;
    const int jumped = m->t >= m->v[AT] - m->v[MARGIN];
    const double values[COUNT] = {jumped, jumped ? INFINITY : m->v[AT], m->v[AT], m->v[MARGIN]};
    for (size_t i = 0; i < n; i++) value[i] = values[r[i]];
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
                       const fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) ((Model *)c)->v[r[i]] = value[i];
    return fmi2OK;
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible,
                              fmi2Boolean logging) {
    return calloc(1, sizeof(Model));
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real start,
                               fmi2Boolean d, fmi2Real stop) {
    ((Model *)c)->t = start;
    return fmi2OK;
}

#include "held.h"

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    return fmi2Error;
}

fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }

fmi2Status fmi2Reset(fmi2Component c) {
    memset(c, 0, sizeof(Model));
    return fmi2OK;
}

#include "rest.h"
