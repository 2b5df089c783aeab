/* A quarter truck in two parts, as an FMU that solves itself to a tolerance of 1e-4 by an embedded
   Runge-Kutta pair of orders 2(1), as some tools do: it can save its state, holds its input, and
   knows no derivatives. part 0 is the chassis, 400 kg: in is the force on it. part 1 is the wheel,
   40 kg, on a road at 0.1 m: in is the velocity of the chassis, force is that of spring and damper
   between the two. acceleration is that at the start of the last inner step. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { IN, FORCE, POSITION, VELOCITY, ACCELERATION, PART, COUNT };
enum { SOLVER_TOLERANCE_INVERSE = 10000 };

typedef struct {
    double in, part, x[3], h; /* position, velocity, position of the chassis; the next inner step */
    double acceleration;
} Model;

static double force(const Model *m, const double x[3]) {
    return 15e3 * (x[0] - x[2]) + 1e3 * (x[1] - m->in);
}

static void derivative(const Model *m, const double x[3], double dx[3]) {
    double road = 150e3 * (0.1 - x[0]) - 0.5 * x[1];
    dx[0] = x[1];
    dx[1] = m->part == 0 ? m->in / 400 : (road - force(m, x)) / 40;
    dx[2] = m->part == 0 ? 0 : m->in;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real length, fmi2Boolean no) {
    Model *m = c;
    double left = length;
    if (m->h == 0) m->h = 1e-3;
    while (left > 1e-14 * length) {
        double h = fmin(m->h, left), k1[3], k2[3], x[3], error = 0;
        derivative(m, m->x, k1);
        for (int i = 0; i < 3; i++) x[i] = m->x[i] + h * k1[i];
        derivative(m, x, k2);
        for (int i = 0; i < 3; i++) {
            double scale = (1 + fabs(m->x[i])) / SOLVER_TOLERANCE_INVERSE;
            error = fmax(error, fabs(h * (k2[i] - k1[i]) / 2) / scale);
            x[i] = m->x[i] + h * (k1[i] + k2[i]) / 2;
        }
        if (error <= 1) {
            memcpy(m->x, x, sizeof x);
            m->acceleration = k1[1];
            left -= h;
        }
        m->h = h * fmin(5, fmax(0.2, 0.95 / sqrt(error + 1e-12)));
    }
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
    Model *m = c;
    double values[COUNT] = {m->in, force(m, m->x), m->x[0], m->x[1], m->acceleration, m->part};
    for (size_t i = 0; i < n; i++) value[i] = values[r[i]];
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
                       const fmi2Real value[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) *(r[i] == IN ? &m->in : &m->part) = value[i];
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
