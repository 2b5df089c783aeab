/* Signals of time, and x' = a x + u + switch + level, which is solved exactly for held inputs:
   s = sin(w t), held = sin(5 k / 10) since t = k / 10, z = cos(50 t) with its derivative,
   on = t >= 0.3337, count = floor(10 t). With `fault` 1 the derivative of z is no number; with 2 the FMU
   refuses steps that do not begin where the last one ended, and saved states are without its time;
   with 3, s is 1 from t = 3.3 to 4.3 and otherwise 0; with 4, s is a relay with hysteresis, which looks
   at u when a step begins: 1 until u > 0.1, then -1 until u < -0.1; with 5, x falls from 1 with an
   acceleration of 9.81, and bounces with 0.8 of its speed when a step begins at or below 0. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define HAS_DISCRETE
enum { U, X, S, HELD, Z, SLOPE, A, W, FAULT, COUNT };

typedef struct {
    double v[COUNT], x, t, speed;
    int switched, level, lowers;
    double *ended;
} Model;

static const Model NEW = {.v = {[W] = 1.0}};

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible,
                              fmi2Boolean logging) {
    Model *m = malloc(sizeof(Model));
    *m = NEW;
    m->ended = calloc(1, sizeof(double));
    return m;
}

void fmi2FreeInstance(fmi2Component c) {
    free(((Model *)c)->ended);
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real start,
                               fmi2Boolean d, fmi2Real stop) {
    ((Model *)c)->t = *((Model *)c)->ended = start;
    return fmi2OK;
}

static int counted(const Model *m) { return (int)floor(10.0 * m->t + 1e-9); }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) switch (r[i]) {
        case X: value[i] = m->x; break;
        case S:
            value[i] = m->v[FAULT] == 3 ? m->t >= 3.3 && m->t < 4.3
                     : m->v[FAULT] == 4 ? 1.0 - 2.0 * m->lowers
                     : sin(m->v[W] * m->t);
            break;
        case HELD: value[i] = sin(0.5 * counted(m)); break;
        case Z: value[i] = cos(50.0 * m->t); break;
        case SLOPE: value[i] = m->v[FAULT] == 1 ? NAN : -50.0 * sin(50.0 * m->t); break;
        default: value[i] = m->v[r[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
                       const fmi2Real value[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) {
        m->v[r[i]] = value[i];
        if (r[i] == FAULT && value[i] == 5) m->x = 1.0;
    }
    return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) v[i] = r[i] ? m->t >= 0.3337 : m->switched;
    return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n,
                          const fmi2Boolean v[]) {
    ((Model *)c)->switched = v[0];
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) v[i] = r[i] ? counted(m) : m->level;
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n,
                          const fmi2Integer v[]) {
    ((Model *)c)->level = v[0];
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no) {
    Model *m = c;
    if (m->v[FAULT] == 2 && fabs(t - *m->ended) > 1e-12) return fmi2Error;
    *m->ended = t + h;
    if (fabs(m->v[U]) > 0.1) m->lowers = m->v[U] > 0.1;
    double a = m->v[A], b = m->v[U] + m->switched + m->level;
    if (m->v[FAULT] == 5) {
        const double g = 9.81;
        if (m->x <= 0 && m->speed < 0) m->speed *= -0.8;
        m->x += h * (m->speed - g * h / 2.0);
        m->speed -= g * h;
    } else m->x = exp(a * h) * m->x + (a == 0 ? h : expm1(a * h) / a) * b;
    m->t = t + h;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    double *ended = ((Model *)c)->ended;
    *(Model *)c = NEW;
    ((Model *)c)->ended = ended;
    return fmi2OK;
}

#include "held.h"

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    return fmi2Error;
}

fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }

#include "rest.h"
