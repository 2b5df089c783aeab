/* The loop of a figure as one differential equation in C, of the functions that are in its native FMUs,
   and compiled solvers on it. Each run goes from jump to jump of theta, and keeps rows (t, X). */

#include <stdlib.h>

#include "structures.h"

enum { THETAS = 4, SINES = 8, LARGEST = 64 };

/* theta_j on one smooth piece: held + sum of amplitude sin(omega t + phase). */
typedef struct {
    double start, end, held[THETAS], sines[THETAS][SINES][3];
    int counts[THETAS];
} Segment;

void plant_rates(const double *x, const double *v, const double *theta, double *result);
void controller_rates(const double *x, const double *v, const double *theta, double *result);
void controller_outputs(const double *x, const double *v, double *result);

static int n_plant, n_all, n_theta;
static const Segment *now;
static long evaluations;

EXPORT void sizes(int plant, int all, int theta) { n_plant = plant; n_all = all; n_theta = theta; }

static inline void right_hand_side(double t, const double *X, double *f) {
    double theta[THETAS], outputs[LARGEST];
    for (int j = 0; j < n_theta; j++) {
        theta[j] = now->held[j];
        for (int k = 0; k < now->counts[j]; k++) {
            const double *s = now->sines[j][k];
            theta[j] += s[0] * sin(s[1] * t + s[2]);
        }
    }
    evaluations++;
    controller_outputs(X + n_plant, X, outputs);
    plant_rates(X, outputs, theta, f);
    controller_rates(X + n_plant, X, theta, f + n_plant);
}

EXPORT void evaluated(const Segment *segment, double t, const double *X, double *f) {
    now = segment;
    right_hand_side(t, X, f);
}

EXPORT long evaluation_count(void) { const long count = evaluations; evaluations = 0; return count; }

static long keep(double *rows, long count, double t, const double *X) {
    rows[count * (1 + n_all)] = t;
    memcpy(rows + count * (1 + n_all) + 1, X, (size_t)n_all * sizeof(double));
    return count + 1;
}

/* -- DOP853, the very code of the compiled loop ---------------------------------------------------- */

#include "dop853.c"

static int rates(Integrator *in, double t, const double *x, double *f) {
    (void)in;
    right_hand_side(t, x, f);
    return DONE;
}

/* The number of rows, one for each step; -1 where it failed. */
EXPORT long run_inlined(Integrator *in, const Segment *segments, int count, double *rows) {
    long kept = 0;
    for (int k = 0; k < count; k++) {
        double t = segments[k].start;
        now = segments + k;
        in->restarts = 1;
        in->step = 0.0;
        while (t < segments[k].end) {
            if (advance(in, &t, segments[k].end)) return -1;
            kept = keep(rows, kept, t, in->x);
        }
    }
    return kept;
}

static void general(double t, double *X, double *f, void *data) {
    (void)data;
    right_hand_side(t, X, f);
}

#ifdef LSODA
/* -- LSODA, that of numbalsoda ------------------------------------------------------------------------ */

void lsoda_wrapper(void (*)(double, double *, double *, void *), int, double *, void *, int, double *,
                   double *, double, double, int, int *);

/* `points` rows in each segment. */
EXPORT long run_lsoda(double *X, const Segment *segments, int count, int points, double rtol,
                      double atol, double *rows) {
    static double times[LARGEST], found[LARGEST * LARGEST];
    long kept = 0;
    for (int k = 0; k < count; k++) {
        int success = 0;
        now = segments + k;
        for (int i = 0; i <= points; i++)
            times[i] = now->start + (now->end - now->start) * i / points;
        times[points] = now->end;
        lsoda_wrapper(general, n_all, X, NULL, points + 1, times, found, rtol, atol, 100000, &success);
        if (!success) return -1;
        for (int i = 1; i <= points; i++) kept = keep(rows, kept, times[i], found + i * n_all);
        memcpy(X, found + points * n_all, (size_t)n_all * sizeof(double));
    }
    return kept;
}
#endif

#ifdef CVODE
/* -- CVODE of SUNDIALS 7, declared here as its headers do not come with its binaries ------------------ */

int SUNContext_Create(int, void **);
void *N_VMake_Serial(long, double *, void *);
double *N_VGetArrayPointer(void *);
void *CVodeCreate(int, void *);
int CVodeInit(void *, int (*)(double, void *, void *, void *), double, void *);
int CVodeReInit(void *, double, void *);
int CVodeSStolerances(void *, double, double);
int CVodeSetMaxNumSteps(void *, long);
int CVodeSetStopTime(void *, double);
void *SUNDenseMatrix(long, long, void *);
void *SUNLinSol_Dense(void *, void *, void *);
int CVodeSetLinearSolver(void *, void *, void *);
int CVode(void *, double, void *, double *, int);

static int of_vectors(double t, void *X, void *f, void *data) {
    (void)data;
    right_hand_side(t, N_VGetArrayPointer(X), N_VGetArrayPointer(f));
    return 0;
}

/* `method` is 1 for Adams and 2 for BDF, both with Newton iterations on a dense Jacobian. */
EXPORT long run_cvode(int method, double *X, const Segment *segments, int count, int points,
                      double rtol, double atol, double *rows) {
    static void *context, *solvers[3], *vectors[3];
    static int made[3];
    long kept = 0;
    if (!context && SUNContext_Create(0, &context)) return -1;
    for (int k = 0; k < count; k++) {
        now = segments + k;
        if (made[method] != n_all) {
            vectors[method] = N_VMake_Serial(n_all, calloc((size_t)n_all, sizeof(double)), context);
            memcpy(N_VGetArrayPointer(vectors[method]), X, (size_t)n_all * sizeof(double));
            solvers[method] = CVodeCreate(method, context);
            void *matrix = SUNDenseMatrix(n_all, n_all, context);
            if (CVodeInit(solvers[method], of_vectors, now->start, vectors[method])
                || CVodeSStolerances(solvers[method], rtol, atol)
                || CVodeSetMaxNumSteps(solvers[method], 100000)
                || CVodeSetLinearSolver(solvers[method],
                                        SUNLinSol_Dense(vectors[method], matrix, context), matrix))
                return -1;
            made[method] = n_all;
        }
        double *values = N_VGetArrayPointer(vectors[method]);
        memcpy(values, X, (size_t)n_all * sizeof(double));
        if (CVodeReInit(solvers[method], now->start, vectors[method])
            || CVodeSStolerances(solvers[method], rtol, atol)
            || CVodeSetStopTime(solvers[method], now->end))
            return -1;
        for (int i = 1; i <= points; i++) {
            double t = now->start;
            const double until = i < points ? now->start + (now->end - now->start) * i / points
                                            : now->end;
            if (CVode(solvers[method], until, vectors[method], &t, 1) < 0) return -1;
            kept = keep(rows, kept, t, values);
        }
        memcpy(X, values, (size_t)n_all * sizeof(double));
    }
    return kept;
}
#endif
