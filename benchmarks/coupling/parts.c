/* All parts of the coupling problems in one library: equations first, then the FMU around them.

   A part is x' = f(t, x, u), y = g(t, x, u) with parameters p; which one an instance is follows from
   its guid. The linear part is solved exactly, also where its inputs are polynomials; the others by
   the classical Runge-Kutta method with steps of at most INNER, a parameter. All functions of FMI
   2.0 for states and derivatives are there; what an FMU may use of them, its model description
   declares. References: inputs, outputs, parameters, start values of the states, INNER. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define MAX_X 4
#define MAX_U 2
#define MAX_Y 2
#define MAX_P 36
#define ORDERS 4 /* an input, and its first three derivatives */

typedef const double *In;
typedef double *Out;

/* y' is given the derivatives of x and u, as v and w. */
typedef struct {
    const char *name;
    int nx, nu, ny, np;
    void (*f)(double t, In x, In u, In p, Out dx);
    void (*g)(double t, In x, In u, In p, Out y);
    void (*rate)(double t, In x, In v, In u, In w, In p, Out dy);
    void (*commit)(In u, In p, Out x); /* at the end of a step: discrete states */
} Part;

#define F(name) static void name##_f(double t, In x, In u, In p, Out dx)
#define G(name) static void name##_g(double t, In x, In u, In p, Out y)
#define RATE(name) static void name##_rate(double t, In x, In v, In u, In w, In p, Out dy)

/* linear: x' = A x + B u, y = C x + D u; p = A (4 x 4), B (4 x 2), C (2 x 4), D (2 x 2) by rows. */
static void product(In M, int columns, In v, int rows, Out sum) {
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < columns; j++) sum[i] += M[i * columns + j] * v[j];
}
F(linear) {
    memset(dx, 0, MAX_X * sizeof *dx);
    product(p, 4, x, 4, dx);
    product(p + 16, 2, u, 4, dx);
}
G(linear) {
    memset(y, 0, MAX_Y * sizeof *y);
    product(p + 24, 4, x, 2, y);
    product(p + 32, 2, u, 2, y);
}
RATE(linear) { linear_g(t, v, w, p, dy); }

/* vanderpol: x' = mu (1 - u^2) x - u, y = x. */
F(vanderpol) { dx[0] = p[0] * (1 - u[0] * u[0]) * x[0] - u[0]; }

/* lorenz: x1' = u (r - x2) - x1, x2' = u x1 - b x2, y = x1. */
F(lorenz) {
    dx[0] = u[0] * (p[0] - x[1]) - x[0];
    dx[1] = u[0] * x[0] - p[1] * x[1];
}

/* species: x' = x (a + b u), y = x. */
F(species) { dx[0] = x[0] * (p[0] + p[1] * u[0]); }

/* tank: x' = (u - c sqrt(x)) / A, y1 = c sqrt(x), y2 = x. */
static double outflow(double level, double c) { return c * sqrt(level > 0 ? level : 0); }
F(tank) { dx[0] = (u[0] - outflow(x[0], p[0])) / p[1]; }
G(tank) {
    y[0] = outflow(x[0], p[0]);
    y[1] = x[0];
}
RATE(tank) {
    double q = outflow(x[0], p[0]);
    dy[0] = q > 0 ? p[0] * p[0] * v[0] / (2 * q) : 0;
    dy[1] = v[0];
}

/* activator: x' = a + x^2 u - (b + 1) x; inhibitor: x' = b u - u^2 x; y = x. */
F(activator) { dx[0] = p[0] + x[0] * x[0] * u[0] - (p[1] + 1) * x[0]; }
F(inhibitor) { dx[0] = p[0] * u[0] - u[0] * u[0] * x[0]; }

/* phase: x' = w + k sin(u1 - x) + k sin(u2 - x), y = x. */
F(phase) { dx[0] = p[0] + p[1] * (sin(u[0] - x[0]) + sin(u[1] - x[0])); }

/* pendulum: x1' = x2, x2' = -g/l sin(x1) - d x2 + u, y = (x1, x2). */
F(pendulum) {
    dx[0] = x[1];
    dx[1] = -p[0] * sin(x[0]) - p[1] * x[1] + u[0];
}

/* membrane: x' = x - x^3 / 3 - u + i, y = x. */
F(membrane) { dx[0] = x[0] - x[0] * x[0] * x[0] / 3 - u[0] + p[0]; }

/* hardening: y = -k u - b u^3, a spring without a state. */
G(hardening) { y[0] = -p[0] * u[0] - p[1] * u[0] * u[0] * u[0]; }
RATE(hardening) { dy[0] = -(p[0] + 3 * p[1] * u[0] * u[0]) * w[0]; }

/* relay: y = high once u is below -band, low once it is above band; x is the last y. */
static double switched(In u, In p, double last) {
    return u[0] < -p[2] ? p[1] : u[0] > p[2] ? p[0] : last;
}
G(relay) { y[0] = switched(u, p, x[0]); }
RATE(relay) { dy[0] = 0; }
static void relay_commit(In u, In p, Out x) { x[0] = switched(u, p, x[0]); }

/* y = x, for parts that have no more to say. */
G(states) { memcpy(y, x, MAX_Y * sizeof *y); }
RATE(states) { memcpy(dy, v, MAX_Y * sizeof *dy); }

static const Part PARTS[] = {
    {"linear", 4, 2, 2, 36, linear_f, linear_g, linear_rate},
    {"vanderpol", 1, 1, 1, 1, vanderpol_f, states_g, states_rate},
    {"lorenz", 2, 1, 2, 2, lorenz_f, states_g, states_rate},
    {"species", 1, 1, 1, 2, species_f, states_g, states_rate},
    {"tank", 1, 1, 2, 2, tank_f, tank_g, tank_rate},
    {"activator", 1, 1, 1, 2, activator_f, states_g, states_rate},
    {"inhibitor", 1, 1, 1, 1, inhibitor_f, states_g, states_rate},
    {"phase", 1, 2, 1, 2, phase_f, states_g, states_rate},
    {"pendulum", 2, 1, 2, 2, pendulum_f, states_g, states_rate},
    {"membrane", 1, 1, 1, 1, membrane_f, states_g, states_rate},
    {"hardening", 0, 1, 1, 2, NULL, hardening_g, hardening_rate},
    {"relay", 1, 1, 1, 3, NULL, relay_g, relay_rate, relay_commit},
};

/* -- the FMU ---------------------------------------------------------------------------------- */

typedef struct {
    const Part *part;
    double time, since; /* of the last step's start: u belongs to it */
    double x[MAX_X], p[MAX_P], inner;
    double u[ORDERS][MAX_U], y[MAX_Y];
} Model;

/* The inputs `s` after they were given, and their derivatives. */
static void inputs(const Model *m, double s, Out u, Out w) {
    for (int k = 0; k < MAX_U; k++) {
        u[k] = m->u[0][k] + s * (m->u[1][k] + s * (m->u[2][k] / 2 + s * m->u[3][k] / 6));
        w[k] = m->u[1][k] + s * (m->u[2][k] + s * m->u[3][k] / 2);
    }
}

static void slope(const Model *m, double s, In x, Out dx) {
    double u[MAX_U], w[MAX_U];
    inputs(m, s, u, w);
    m->part->f(m->time + s, x, u, m->p, dx);
}

/* The Taylor series of x, whose derivatives are A x^(k) + B u^(k), in pieces of norm(A) h < 1/2. */
static void exact(Model *m, double h) {
    double norm = 0;
    for (int i = 0; i < 4; i++) {
        double row = 0;
        for (int j = 0; j < 4; j++) row += fabs(m->p[4 * i + j]);
        norm = fmax(norm, row);
    }
    int n = 1 + (int)(2 * norm * h);
    double d = h / n;
    for (int i = 0; i < n; i++) {
        double u[ORDERS][MAX_U] = {{0}}, dx[MAX_X], term[MAX_X], none[MAX_U] = {0};
        inputs(m, i * d, u[0], u[1]);
        for (int k = 0; k < MAX_U; k++) {
            u[2][k] = m->u[2][k] + i * d * m->u[3][k];
            u[3][k] = m->u[3][k];
        }
        memcpy(term, m->x, sizeof term);
        double scale = 1;
        for (int k = 0; k < 24; k++) {
            linear_f(0, term, k < ORDERS ? u[k] : none, m->p, dx);
            scale *= d / (k + 1);
            for (int j = 0; j < MAX_X; j++) m->x[j] += scale * dx[j];
            memcpy(term, dx, sizeof term);
        }
    }
}

static void runge_kutta(Model *m, double h) {
    int n = (int)ceil(h / m->inner - 1e-9), nx = m->part->nx;
    if (n < 1) n = 1;
    double d = h / n, k[4][MAX_X], z[MAX_X];
    static const double at[4] = {0, 0.5, 0.5, 1}, weight[4] = {1, 2, 2, 1};
    for (int i = 0; i < n; i++) {
        for (int stage = 0; stage < 4; stage++) {
            for (int j = 0; j < nx; j++)
                z[j] = m->x[j] + (stage ? at[stage] * d * k[stage - 1][j] : 0);
            slope(m, (i + at[stage]) * d, z, k[stage]);
        }
        for (int stage = 0; stage < 4; stage++)
            for (int j = 0; j < nx; j++) m->x[j] += d / 6 * weight[stage] * k[stage][j];
    }
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible,
                              fmi2Boolean logging) {
    Model *m = calloc(1, sizeof(Model));
    for (size_t k = 0; m && k < sizeof PARTS / sizeof *PARTS; k++)
        if (!strncmp(guid, PARTS[k].name, strlen(PARTS[k].name))) m->part = &PARTS[k];
    if (m && !m->part) {
        free(m);
        return NULL;
    }
    if (m) m->inner = 1e-3;
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2Reset(fmi2Component c) {
    Model *m = c, fresh = {.part = m->part, .inner = 1e-3};
    *m = fresh;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real start,
                               fmi2Boolean d, fmi2Real stop) {
    ((Model *)c)->time = start;
    return fmi2OK;
}

static void committed(Model *m) {
    double u[MAX_U], w[MAX_U];
    inputs(m, m->since, u, w);
    if (m->part->commit) m->part->commit(u, m->p, m->x);
}

/* Where a reference stands; outputs are computed where they are read. */
static double *place(Model *m, fmi2ValueReference r) {
    const Part *part = m->part;
    int k = (int)r;
    if (k < part->nu) return &m->u[0][k];
    if ((k -= part->nu) < part->ny) return &m->y[k];
    if ((k -= part->ny) < part->np) return &m->p[k];
    if ((k -= part->np) < part->nx) return &m->x[k];
    return k == part->nx ? &m->inner : NULL;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
    Model *m = c;
    double u[MAX_U], w[MAX_U];
    inputs(m, m->since, u, w);
    m->part->g(m->time, m->x, u, m->p, m->y);
    for (size_t i = 0; i < n; i++) {
        const double *found = place(m, r[i]);
        if (!found) return fmi2Error;
        value[i] = (int)r[i] < m->part->nu ? u[r[i]] : *found;
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
                       const fmi2Real value[]) {
    Model *m = c;
    double u[MAX_U], w[MAX_U];
    inputs(m, m->since, u, w);
    for (size_t i = 0; i < n; i++)
        if ((int)r[i] < m->part->nu) {
            /* A new input begins now, and so do those that are not given. */
            for (int k = 0; k < MAX_U; k++) {
                m->u[0][k] = u[k];
                m->u[1][k] = m->u[2][k] = m->u[3][k] = 0;
            }
            m->since = 0;
            break;
        }
    for (size_t i = 0; i < n; i++) {
        double *found = place(m, r[i]);
        if (!found) return fmi2Error;
        *found = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) {
        if ((int)r[i] >= m->part->nu || order[i] < 1 || order[i] >= ORDERS) return fmi2Error;
        m->u[order[i]][r[i]] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    Model *m = c;
    const Part *part = m->part;
    double u[MAX_U], w[MAX_U], v[MAX_X] = {0}, dy[MAX_Y];
    inputs(m, m->since, u, w);
    if (part->f) part->f(m->time, m->x, u, m->p, v);
    part->rate(m->time, m->x, v, u, w, m->p, dy);
    for (size_t i = 0; i < n; i++) {
        int k = (int)r[i] - part->nu;
        if (k < 0 || k >= part->ny || order[i] != 1) return fmi2Error;
        value[i] = dy[k];
    }
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no) {
    Model *m = c;
    /* A step whose inputs were not given anew goes on with those before. */
    if (m->since > 0) {
        double u[MAX_U], w[MAX_U];
        inputs(m, m->since, u, w);
        for (int k = 0; k < MAX_U; k++) {
            m->u[2][k] += m->since * m->u[3][k];
            m->u[1][k] = w[k];
            m->u[0][k] = u[k];
        }
    }
    m->time = t;
    if (m->part->f == linear_f)
        exact(m, h);
    else if (m->part->f)
        runge_kutta(m, h);
    m->time = t + h;
    m->since = h;
    committed(m);
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    committed(c);
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!*state) *state = malloc(sizeof(Model));
    if (!*state) return fmi2Error;
    memcpy(*state, c, sizeof(Model));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    memcpy(c, state, sizeof(Model));
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    free(*state);
    *state = NULL;
    return fmi2OK;
}

/* -- what these FMUs have no use for --------------------------------------------------------- */

#define NOTHING(name) \
    fmi2Status name(fmi2Component c) { return fmi2OK; }
#define UNUSED(name, ...) \
    fmi2Status name(fmi2Component c, __VA_ARGS__) { return fmi2Error; }

NOTHING(fmi2EnterInitializationMode)
NOTHING(fmi2Terminate)
NOTHING(fmi2CancelStep)
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) {
    return fmi2OK;
}
UNUSED(fmi2GetInteger, const fmi2ValueReference r[], size_t n, fmi2Integer v[])
UNUSED(fmi2GetBoolean, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
UNUSED(fmi2GetString, const fmi2ValueReference r[], size_t n, fmi2String v[])
UNUSED(fmi2SetInteger, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
UNUSED(fmi2SetBoolean, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
UNUSED(fmi2SetString, const fmi2ValueReference r[], size_t n, const fmi2String v[])
UNUSED(fmi2SerializedFMUstateSize, fmi2FMUstate s, size_t *n)
UNUSED(fmi2SerializeFMUstate, fmi2FMUstate s, fmi2Byte b[], size_t n)
UNUSED(fmi2DeSerializeFMUstate, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
UNUSED(fmi2GetDirectionalDerivative, const fmi2ValueReference a[], size_t n,
       const fmi2ValueReference b[], size_t m, const fmi2Real v[], fmi2Real w[])
UNUSED(fmi2GetStatus, const fmi2StatusKind k, fmi2Status *v)
UNUSED(fmi2GetRealStatus, const fmi2StatusKind k, fmi2Real *v)
UNUSED(fmi2GetIntegerStatus, const fmi2StatusKind k, fmi2Integer *v)
UNUSED(fmi2GetBooleanStatus, const fmi2StatusKind k, fmi2Boolean *v)
UNUSED(fmi2GetStringStatus, const fmi2StatusKind k, fmi2String *v)
