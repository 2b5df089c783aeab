/* x' = a x + b1 u1 + b2 u2, y = x + d1 u1 + d2 u2: an FMU as most tools write them. It can save its
   state, holds its inputs over a step, which it solves exactly, and knows no derivatives. With
   `grain` its outputs are rounded to multiples of that, as an inaccurate solver inside would do; at the
   time `ends` it ends the run. A step past t = 0.5, or the end, goes wrong in the way that `fault`
   says. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmi2Functions.h"

enum { U1, U2, Y, A, B1, B2, D1, D2, X0, GRAIN, ENDS, FAULT, COUNT };
enum { NONE, CRASHES, ABORTS, EXITS, HANGS, HANGS_WITH_LOCK, NOT_A_NUMBER, DISCARDS, REFUSES,
       CRASHES_AT_THE_END, WARNS, HANGS_AT_THE_END, REFUSES_THE_END };

typedef struct {
    double v[COUNT], x;
    const fmi2CallbackFunctions *callbacks;
} Model;

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible,
                              fmi2Boolean logging) {
    Model *m = calloc(1, sizeof(Model));
    m->callbacks = f;
    return m;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real start,
                               fmi2Boolean d, fmi2Real stop) {
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) {
        double y = m->x + m->v[D1] * m->v[U1] + m->v[D2] * m->v[U2];
        if (m->v[GRAIN] > 0) y = m->v[GRAIN] * round(y / m->v[GRAIN]);
        value[i] = r[i] == Y ? y : m->v[r[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
                       const fmi2Real value[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) {
        m->v[r[i]] = value[i];
        if (r[i] == X0) m->x = value[i];
    }
    return fmi2OK;
}

static void fail(Model *m) {
    volatile int *volatile nowhere = NULL;
    int (*lock)(void);
    switch ((int)m->v[FAULT]) {
    case CRASHES: *nowhere = 1; break;
    case ABORTS: abort();
    case EXITS: exit(0);
    case HANGS_WITH_LOCK: /* of the interpreter that has loaded this library */
        *(void **)&lock = dlsym(RTLD_DEFAULT, "PyGILState_Ensure");
        lock();
        /* fall through */
    case HANGS: for (;;) pause();
    case NOT_A_NUMBER: m->x = NAN; break;
    case WARNS:
        m->callbacks->logger(m->callbacks->componentEnvironment, "plain", fmi2Warning,
                             "logStatusWarning", "x = %g is large", m->x);
    }
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no) {
    Model *m = c;
    if (t + h > 0.5) {
        if (m->v[FAULT] == DISCARDS) return fmi2Discard;
        if (m->v[FAULT] == REFUSES) return fmi2Error;
        fail(m);
    }
    if (m->v[ENDS] > 0 && t + h > m->v[ENDS]) return fmi2Discard;
    double a = m->v[A], b = m->v[B1] * m->v[U1] + m->v[B2] * m->v[U2];
    m->x = exp(a * h) * m->x + (a == 0 ? h : expm1(a * h) / a) * b;
    return fmi2OK;
}

#include "held.h"

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    *value = kind == fmi2Terminated && ((Model *)c)->v[ENDS] > 0;
    return fmi2OK;
}

/* In the file that the environment names: "T" for each run that was terminated, "R" for each reset. */
static void note(const char *letter) {
    const char *path = getenv("PLAIN_FMU_NOTES");
    FILE *file = path ? fopen(path, "a") : NULL;
    if (file) {
        fputs(letter, file);
        fclose(file);
    }
}

fmi2Status fmi2Terminate(fmi2Component c) {
    volatile int *volatile nowhere = NULL;
    Model *m = c;
    note("T");
    switch ((int)m->v[FAULT]) {
    case CRASHES_AT_THE_END: *nowhere = 1; break;
    case HANGS_AT_THE_END: for (;;) pause();
    case REFUSES_THE_END:
        m->callbacks->logger(m->callbacks->componentEnvironment, "plain", fmi2Error,
                             "logStatusError", "the report cannot be written");
        return fmi2Error;
    }
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    Model *m = c;
    note("R");
    *m = (Model){.callbacks = m->callbacks};
    return fmi2OK;
}

#include "rest.h"
