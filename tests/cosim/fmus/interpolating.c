/* x' = v, v' = -4 x + u, y = x, f = u: an FMU that takes input derivatives and gives output
   derivatives by the functions of FMI 2.0, as tools do that have no der(.) variables. */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define ORDERS 4

typedef struct {
    double x, v, time, offset;
    double u[ORDERS]; /* u, u', u'', u''' at the communication point */
    fmi2CallbackLogger log;
    fmi2ComponentEnvironment environment;
} Model;

static double input(const Model *m, double s) {
    return m->u[0] + s * (m->u[1] + s * (m->u[2] / 2 + s * m->u[3] / 6));
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible,
                              fmi2Boolean logging) {
    Model *m = calloc(1, sizeof(Model));
    m->x = 1;
    m->log = f->logger;
    m->environment = f->componentEnvironment;
    return m;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2Reset(fmi2Component c) {
    Model *m = c, fresh = {.x = 1, .log = m->log, .environment = m->environment};
    *m = fresh;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real start,
                               fmi2Boolean d, fmi2Real stop) {
    ((Model *)c)->time = start;
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) {
        switch (r[i]) {
        case 0: value[i] = m->u[0]; break;
        case 1: value[i] = m->x; break;
        case 2: value[i] = input(m, m->offset); break;
        default:
            m->log(m->environment, "", fmi2Error, "", "reference %u of %d%% is unknown", r[i], 100);
            return fmi2Error;
        }
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
                       const fmi2Real value[]) {
    Model *m = c;
    memset(m->u, 0, sizeof m->u);
    m->offset = 0;
    for (size_t i = 0; i < n; i++) m->u[0] = value[i];
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) {
        if (r[i] != 0 || order[i] < 1 || order[i] >= ORDERS) return fmi2Error;
        ((Model *)c)->u[order[i]] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    Model *m = c;
    double s = m->offset;
    for (size_t i = 0; i < n; i++) {
        if (order[i] != 1) return fmi2Error;
        value[i] = r[i] == 1 ? m->v : m->u[1] + s * (m->u[2] + s * m->u[3] / 2);
    }
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no) {
    Model *m = c;
    int n = 1 + (int)(h / 1e-3);
    double d = h / n;
    for (int i = 0; i < n; i++) {
        double s = i * d, x = m->x, v = m->v;
        double k1 = v, l1 = -4 * x + input(m, s);
        double k2 = v + d / 2 * l1, l2 = -4 * (x + d / 2 * k1) + input(m, s + d / 2);
        double k3 = v + d / 2 * l2, l3 = -4 * (x + d / 2 * k2) + input(m, s + d / 2);
        double k4 = v + d * l3, l4 = -4 * (x + d * k3) + input(m, s + d);
        m->x += d / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
        m->v += d / 6 * (l1 + 2 * l2 + 2 * l3 + l4);
    }
    m->time = t + h;
    m->offset = h;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    return fmi2Discard;
}

#include "rest.h"
