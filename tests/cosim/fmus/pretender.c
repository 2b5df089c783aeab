/* A part of the coupling problems that declares everything and lacks one thing, by LACK:
   1 refuses derivatives of outputs, 2 says that all are zero, 3 refuses derivatives of inputs,
   4 refuses to save its state, 5 does not restore it, 6 refuses steps of a second length. */

#include "fmi2Functions.h"

#if LACK == 1 || LACK == 2
#undef fmi2GetRealOutputDerivatives
#define fmi2GetRealOutputDerivatives able
#elif LACK == 3
#undef fmi2SetRealInputDerivatives
#define fmi2SetRealInputDerivatives able
#elif LACK == 4
#undef fmi2GetFMUstate
#define fmi2GetFMUstate able
#elif LACK == 5
#undef fmi2SetFMUstate
#define fmi2SetFMUstate able
#else
#undef fmi2DoStep
#define fmi2DoStep able
#undef fmi2ExitInitializationMode
#define fmi2ExitInitializationMode initialised
#endif

#include "parts.c"

#undef fmi2GetRealOutputDerivatives
#undef fmi2SetRealInputDerivatives
#undef fmi2GetFMUstate
#undef fmi2SetFMUstate
#undef fmi2DoStep
#undef fmi2ExitInitializationMode

#if LACK == 1 || LACK == 2
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) value[i] = 0;
    return LACK == 1 ? fmi2Error : fmi2OK;
}
#elif LACK == 3
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    return fmi2Error;
}
#elif LACK == 4
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { return fmi2Error; }
#elif LACK == 5
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { return fmi2OK; }
#else
#define INSTANCES 64
/* The length of its first step, of each instance; no part of the state. */
static struct {
    fmi2Component instance;
    double length;
} grids[INSTANCES];

static double *grid(fmi2Component c) {
    int k = 0;
    while (grids[k].instance && grids[k].instance != c && k < INSTANCES - 1) k++;
    grids[k].instance = c;
    return &grids[k].length;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    *grid(c) = 0;
    return initialised(c);
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no) {
    double *length = grid(c);
    if (*length == 0) *length = h;
    return fabs(h - *length) > 1e-9 * *length ? fmi2Error : able(c, t, h, no);
}
#endif
