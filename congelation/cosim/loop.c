/* The stepping loop, compiled: what stepping.py, held.py and hermite.py do in each communication step.

   It makes the steps of a run and its jumps, and nothing else. Where anything else happens (an FMU that
   does not return fmi2OK, a value that is not finite, iterations that do not converge, a full block of
   rows), it returns, and Python goes on from there: it has the messages and the ends of runs. The arrays
   are those of the Python loop, and the arithmetic is in its order.

   Symbols as in ensemble.py: Y is all that is read; C, of shape (4, L), the polynomials of the inputs,
   u(t + s) = C[0] + C[1] s + C[2] s^2/2 + C[3] s^3/6. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { WARNING = 1 };                                 /* of fmi2Status */
enum { DONE, FULL, REFUSED, NOT_FINITE, UNUSUAL, UNSOLVED };  /* why a run of steps ended */
enum { POINT, BEFORE_JUMP, AFTER_JUMP };              /* what a row is of */

typedef int (*StepFunction)(void *, double, double, int);
typedef int (*RealFunction)(void *, const unsigned *, size_t, double *);
typedef int (*RankedFunction)(void *, const unsigned *, size_t, const int *, double *);
typedef int (*GetStateFunction)(void *, void **);
typedef int (*SetStateFunction)(void *, void *);

/* One call of fmi2GetReal, fmi2SetReal or their relatives for derivatives. */
typedef struct {
    RealFunction plain;       /* NULL: `ranked` is meant */
    RankedFunction ranked;
    const unsigned *references;
    const int *orders;        /* of `ranked` */
    uint64_t note;            /* what stands for the call; see fmi/calls.py */
    size_t count;
    double *values;           /* read: in Y; sent: a buffer of the call, or C itself */
    const ptrdiff_t *places;  /* sent: where the values stand in C; NULL: `values` is in C */
    const double *factors, *offsets;  /* of the units; NULL where none is converted */
} Call;

typedef struct {
    void *component;
    volatile uint64_t *note;  /* where a call is noted before it is made, in case it never returns */
    uint64_t step_note, get_note, free_note, set_note;
    StepFunction step;
    GetStateFunction get_state, free_state;
    SetStateFunction set_state;
    void **states[2];         /* saved at the start of the step, and in the middle of one in halves */
    const Call *reads, *writes, *holds;
    int n_reads, n_writes, n_holds;
    const double *checked;    /* the part of Y in which every value has to be finite */
    size_t n_checked;
    int holds_some;           /* whether an input takes no derivative */
    const unsigned char *forward;  /* (L,): the links whose source steps before their target, and is this */
    const unsigned char *ahead;    /* (L,): the links whose target is this, and whose source steps before */
    int steps_ahead;          /* whether there are any */
    int reaches_end;          /* outputs are read for what held inputs are at the end of a step */
} Slave;

/* Wires that are carried over together; Block of exchange.py. */
typedef struct {
    const int *sources, *targets;  /* slaves to read first, and to set afterwards */
    int n_sources, n_targets;
    ptrdiff_t n;
    const ptrdiff_t *places, *slots;  /* (n,): of the values in Y, and in C */
    const double *nominal;    /* (n,) */
    int loops;                /* whether the values depend on themselves */
} Block;

typedef struct {
    const Slave *slaves;
    int n_slaves, which;      /* `which`: the slave, or block, that ended a run of steps */
    ptrdiff_t n_links;
    double *Y, *C;
    const ptrdiff_t *source, *source_derivative, *columns;  /* `columns`: first link of each slave; where
                                 a source says no derivative, its place is -1 */
    const unsigned char *order;  /* (L,): highest derivative that the input takes */
    int inexact;              /* whether some source says no derivative */
    const double *nominal;
    const Block *blocks;
    double *solving;          /* of 6 n + 2 n^2 numbers, n being the size of the largest block that loops */
    int n_blocks, n_events;
    const ptrdiff_t *events;  /* places in Y of announced jumps; none where no step lands on them */
    double stop;
    /* rows */
    double *rows;             /* (capacity, 1 + width) */
    unsigned char *kinds;     /* (capacity,): what each row is of; NULL: they are rows of EveryStep */
    const ptrdiff_t *recorded;
    ptrdiff_t width, capacity, n_rows;
    long every, left;
    long most;                /* steps after which to return, those taken back included */
    /* what became of it */
    long steps, rejected, events_crossed, floors, passes, calls;
    double largest_error;
    double counted, counted_before;  /* times of the last two steps that were counted */
    int status;               /* of the call that ended a run of steps */
    const char *function;     /* that call */
    double time;              /* at the beginning of its step */
    int level;                /* of the states that are saved and restored */
} Loop;

/* Raised with each change of a structure or a function here: a library of another version, left over
   from an earlier installation, is not used. */
EXPORT int loop_version(void) { return 4; }

static int refused(Loop *loop, int status, const char *function) {
    loop->status = status;
    loop->function = function;
    return REFUSED;
}

static int call_reads(Loop *loop, const Slave *slave) {
    for (int k = 0; k < slave->n_reads; k++) {
        const Call *call = &slave->reads[k];
        *slave->note = call->note;
        int status = call->plain
            ? call->plain(slave->component, call->references, call->count, call->values)
            : call->ranked(slave->component, call->references, call->count, call->orders, call->values);
        if (status > WARNING)
            return refused(loop, status, call->plain ? "fmi2GetReal" : "fmi2GetRealOutputDerivatives");
    }
    return DONE;
}

static int call_writes(Loop *loop, const Slave *slave, const Call *calls, int count) {
    for (int k = 0; k < count; k++) {
        const Call *call = &calls[k];
        if (call->places) {
            for (size_t i = 0; i < call->count; i++) call->values[i] = loop->C[call->places[i]];
            if (call->factors)
                for (size_t i = 0; i < call->count; i++)
                    call->values[i] = call->values[i] * call->factors[i] + call->offsets[i];
        }
        *slave->note = call->note;
        int status = call->plain
            ? call->plain(slave->component, call->references, call->count, call->values)
            : call->ranked(slave->component, call->references, call->count, call->orders, call->values);
        if (status > WARNING)
            return refused(loop, status, call->plain ? "fmi2SetReal" : "fmi2SetRealInputDerivatives");
    }
    return DONE;
}

static int is_finite(const Loop *loop) {
    const double limit = 1e200;  /* the square of LARGEST_VALUE of ensemble.py */
    for (int m = 0; m < loop->n_slaves; m++) {
        const Slave *slave = &loop->slaves[m];
        double sum = 0.0;
        for (size_t i = 0; i < slave->n_checked; i++) sum += slave->checked[i] * slave->checked[i];
        if (!(sum < limit)) return 0;
    }
    return 1;
}

/* A communication point: as EveryStep of recording.py, or for Python to make rows of. */
static void record(Loop *loop, double time, int kind) {
    if (!loop->kinds && kind == BEFORE_JUMP) return;
    if (loop->left && kind == POINT) { loop->left--; return; }
    loop->left = loop->every - 1;
    if (loop->kinds) loop->kinds[loop->n_rows] = (unsigned char)kind;
    double *row = loop->rows + loop->n_rows++ * (1 + loop->width);
    row[0] = time;
    for (ptrdiff_t k = 0; k < loop->width; k++) row[1 + k] = loop->Y[loop->recorded[k]];
}

/* Whether there is room for what a step or a jump records. */
static int has_room(const Loop *loop) {
    return loop->capacity - loop->n_rows >= (loop->kinds ? 2 : 1);
}

/* Session._count: whether as many steps have been made as are to be. */
static int counted(Loop *loop, double time) {
    loop->counted_before = loop->counted;
    loop->counted = time;
    loop->steps++;
    return loop->steps + loop->rejected >= loop->most;
}

static double unit_in_the_last_place(double value) {
    const double size = fabs(value);
    return nextafter(size, INFINITY) - size;
}

static double just_before(double event) { return event - 8.0 * unit_in_the_last_place(event); }

/* Session.next_event */
static double next_event(const Loop *loop, double time) {
    double event = INFINITY;
    for (int k = 0; k < loop->n_events; k++) {
        const double announced = loop->Y[loop->events[k]];
        if (announced > time && announced < event) event = announced;
    }
    if (event > loop->stop) return INFINITY;
    return event < just_before(loop->stop) ? event : loop->stop;
}

/* -- quasi-Newton steps, as broyden.py -------------------------------------------------------------- */

/* Broyden's update of J, (n, n): G moved by dz + dr while z moved by dz. */
static void learn(double *J, const double *dz, const double *dr, ptrdiff_t n, double *missed) {
    double square = 0.0;
    for (ptrdiff_t i = 0; i < n; i++) square += dz[i] * dz[i];
    if (square == 0.0) return;
    for (ptrdiff_t i = 0; i < n; i++) {
        double expected = 0.0;
        for (ptrdiff_t j = 0; j < n; j++) expected += J[i * n + j] * dz[j];
        missed[i] = dz[i] + dr[i] - expected;
    }
    for (ptrdiff_t i = 0; i < n; i++)
        for (ptrdiff_t j = 0; j < n; j++) J[i * n + j] += missed[i] * (dz[j] / square);
}

/* (I - J)^-1 r by elimination with pivots; r itself where that is singular. */
static void quasi_newton(const double *J, const double *r, ptrdiff_t n, double *A, double *x) {
    for (ptrdiff_t i = 0; i < n; i++) {
        x[i] = r[i];
        for (ptrdiff_t j = 0; j < n; j++) A[i * n + j] = (i == j ? 1.0 : 0.0) - J[i * n + j];
    }
    for (ptrdiff_t c = 0; c < n; c++) {
        ptrdiff_t pivot = c;
        for (ptrdiff_t i = c + 1; i < n; i++)
            if (fabs(A[i * n + c]) > fabs(A[pivot * n + c])) pivot = i;
        if (A[pivot * n + c] == 0.0) { memcpy(x, r, (size_t)n * sizeof *x); return; }
        if (pivot != c) {
            for (ptrdiff_t j = 0; j < n; j++) {
                const double kept = A[c * n + j];
                A[c * n + j] = A[pivot * n + j];
                A[pivot * n + j] = kept;
            }
            const double kept = x[c];
            x[c] = x[pivot];
            x[pivot] = kept;
        }
        for (ptrdiff_t i = c + 1; i < n; i++) {
            const double factor = A[i * n + c] / A[c * n + c];
            for (ptrdiff_t j = c; j < n; j++) A[i * n + j] -= factor * A[c * n + j];
            x[i] -= factor * x[c];
        }
    }
    for (ptrdiff_t i = n - 1; i >= 0; i--) {
        for (ptrdiff_t j = i + 1; j < n; j++) x[i] -= A[i * n + j] * x[j];
        x[i] /= A[i * n + i];
    }
}


/* -- outputs and inputs made to agree, as exchange.py ------------------------------------------------- */

enum { MOST_ITERATIONS = 50 };
static const double LOOP_TOLERANCE = 1e-11;

static int read_sources(Loop *loop, const Block *block) {
    for (int i = 0; i < block->n_sources; i++) {
        const Slave *slave = &loop->slaves[loop->which = block->sources[i]];
        const int code = call_reads(loop, slave);
        loop->calls += slave->n_reads;
        if (code) return code;
    }
    return DONE;
}

static int set_targets(Loop *loop, const Block *block, const double *values) {
    for (ptrdiff_t i = 0; values && i < block->n; i++) loop->C[block->slots[i]] = values[i];
    for (int i = 0; i < block->n_targets; i++) {
        const Slave *slave = &loop->slaves[loop->which = block->targets[i]];
        const int code = call_writes(loop, slave, slave->writes, slave->n_writes);
        loop->calls += slave->n_writes;
        if (code) return code;
    }
    return DONE;
}

/* Fixed point first, quasi-Newton from the second iteration on. */
static int solve(Loop *loop, const Block *block) {
    const ptrdiff_t n = block->n;
    double *z = loop->solving, *r = z + n, *dz = r + n, *r_before = dz + n, *dr = r_before + n;
    double *x = dr + n, *J = x + n, *A = J + n * n;
    for (ptrdiff_t i = 0; i < n; i++) z[i] = loop->C[block->slots[i]];
    memset(J, 0, (size_t)(n * n) * sizeof *J);
    for (int count = 0; count < MOST_ITERATIONS; count++) {
        int agrees = 1, finite = 1, code = read_sources(loop, block);
        if (code) return code;
        for (ptrdiff_t i = 0; i < n; i++) {
            r[i] = loop->Y[block->places[i]] - z[i];
            finite &= !!isfinite(r[i]);
            agrees &= fabs(r[i]) <= LOOP_TOLERANCE * (block->nominal[i] + fabs(z[i]));
        }
        if (!finite) break;
        if (agrees) return DONE;
        if (count) {
            for (ptrdiff_t i = 0; i < n; i++) dr[i] = r[i] - r_before[i];
            learn(J, dz, dr, n, x);
        }
        memcpy(r_before, r, (size_t)n * sizeof *r);
        quasi_newton(J, r, n, A, x);
        for (ptrdiff_t i = 0; i < n; i++) {
            const double moved = z[i] + x[i];
            dz[i] = moved - z[i];
            z[i] = moved;
        }
        if ((code = set_targets(loop, block, z))) return code;
    }
    loop->which = (int)(block - loop->blocks);
    return UNSOLVED;
}

/* Exchange.run, of a system without discrete connections. */
EXPORT int run_exchange(Loop *loop) {
    const size_t L = (size_t)loop->n_links;
    memset(loop->C + 2 * L, 0, 2 * L * sizeof(double));
    for (int b = 0; b < loop->n_blocks; b++) {
        const Block *block = &loop->blocks[b];
        int code = read_sources(loop, block);
        /* The values go through C: Y may change while targets are set. */
        for (ptrdiff_t i = 0; !code && i < block->n; i++)
            loop->C[block->slots[i]] = loop->Y[block->places[i]];
        if (!code) code = set_targets(loop, block, NULL);
        if (!code && block->loops) code = solve(loop, block);
        if (code) return code;
    }
    for (int m = 0; m < loop->n_slaves; m++) {
        const Slave *slave = &loop->slaves[loop->which = m];
        const int code = call_reads(loop, slave);
        loop->calls += slave->n_reads;
        if (code) return code;
    }
    return DONE;
}

/* Session.cross: over the jump at `event`, where inputs and outputs are made to agree anew. */
static int cross(Loop *loop, double before, double event) {
    const size_t L = (size_t)loop->n_links;
    record(loop, before, BEFORE_JUMP);
    loop->time = before;
    for (size_t k = 0; k < L; k++) loop->C[k] = loop->Y[loop->source[k]];
    memset(loop->C + L, 0, 3 * L * sizeof(double));
    for (int m = 0; m < loop->n_slaves; m++) {
        const Slave *slave = &loop->slaves[loop->which = m];
        if (call_writes(loop, slave, slave->writes, slave->n_writes)) return REFUSED;
        loop->calls += slave->n_writes;
    }
    for (int m = 0; m < loop->n_slaves; m++) {
        const Slave *slave = &loop->slaves[loop->which = m];
        *slave->note = slave->step_note;
        const int status = slave->step(slave->component, before, event - before, 1);
        if (status > WARNING) return refused(loop, status, "fmi2DoStep");
        loop->calls++;
    }
    const int code = run_exchange(loop);
    if (code) return code;
    loop->events_crossed++;
    if (!is_finite(loop)) return NOT_FINITE;
    record(loop, event, AFTER_JUMP);
    return DONE;
}

/* -- held inputs: Jacobi, Gauss-Seidel ------------------------------------------------------------ */

/* From `start` to each of `count` points. `sequential`: each slave steps with the newest values there
   are. `before`, (L,), are the values of the links at the beginning; afterwards those at the end. */
EXPORT int run_held(Loop *loop, int sequential, double start, const double *points, long count,
                    double *before) {
    const ptrdiff_t L = loop->n_links;
    int code = DONE;
    double time = start;
    for (long k = 0; k < count; k++) {
        if (!has_room(loop)) return FULL;
        const double end = points[k];
        loop->time = time;
        if (!sequential)
            for (ptrdiff_t i = 0; i < L; i++) loop->C[i] = loop->Y[loop->source[i]];
        for (int m = 0; m < loop->n_slaves && !sequential; m++) {
            const Slave *slave = &loop->slaves[m];
            loop->which = m;
            if ((code = call_writes(loop, slave, slave->holds, slave->n_holds))) goto ended;
        }
        for (int m = 0; m < loop->n_slaves; m++) {
            const Slave *slave = &loop->slaves[m];
            loop->which = m;
            if (sequential) {
                for (ptrdiff_t i = loop->columns[m]; i < loop->columns[m + 1]; i++)
                    loop->C[i] = loop->Y[loop->source[i]];
                if ((code = call_writes(loop, slave, slave->holds, slave->n_holds))) goto ended;
            }
            *slave->note = slave->step_note;
            const int status = slave->step(slave->component, time, end - time, 1);
            if (status > WARNING) { code = refused(loop, status, "fmi2DoStep"); goto ended; }
            if (sequential && (code = call_reads(loop, slave))) goto ended;
        }
        for (int m = 0; m < loop->n_slaves && !sequential; m++) {
            loop->which = m;
            if ((code = call_reads(loop, &loop->slaves[m]))) goto ended;
        }
        loop->passes++;
        for (ptrdiff_t i = 0; i < L; i++) {
            const double value = loop->Y[loop->source[i]];
            const double error = fabs(value - before[i]) / (loop->nominal[i] + fabs(value));
            if (error > loop->largest_error) loop->largest_error = error;
            before[i] = value;
        }
        if (!is_finite(loop)) { code = NOT_FINITE; goto ended; }
        record(loop, end, POINT);
        counted(loop, end);
        time = end;
    }
ended:
    return code;
}

/* -- derivative and hermite: polynomials ------------------------------------------------------------ */

enum { LOW = 4, HIGH = 6, KEPT = 3, NODES = 6 };

static const double LONGEST_EXTRAPOLATION = 20.0;  /* points.py */
static const double RESIDUE = 16.0 / 3150.0;       /* interpolant.py */
static const double SAFETY = 0.9, LARGEST_CHANGE = 4.0, SMALLEST_CHANGE = 0.2;  /* step_control.py */
static const double PROPORTIONAL = 0.4, INTEGRAL = 0.7, SMALLEST_ERROR = 1e-4;
static const double STRETCH = 1.1, SMALLEST_STEP = 16.0, SMALLEST_SHARE = 1e-15;  /* stepping.py */
static const double SAMPLED_TOLERANCE = 1e-3, MOST_AMPLIFIED = 200.0;  /* recording.py */

/* OutputGrid of recording.py, as far as it judges steps: its latest communication points since a jump,
   and what is recorded there of values without derivatives. */
typedef struct {
    double interval;          /* steps that are no longer need no judgement */
    ptrdiff_t n_sampled;
    const ptrdiff_t *places;  /* of these values in Y */
    const double *nominal;
    double *samples;          /* (NODES, n_sampled), of the times, in their order */
    double times[NODES];      /* the newest last */
    int n_times;
} Grid;

/* HermiteState, or Points alone: the state of a coupling at a communication point. */
typedef struct {
    double times[KEPT];       /* the newest last */
    int n_times, order;
    double *table;            /* (2, KEPT, L): values and derivatives at these points, the newest last */
    double *J;                /* (n, n) */
    double length;            /* for which J holds; 0: there is none yet */
} State;

/* What a run takes from one step to the next besides; StepSize and Halving of step_control.py. */
typedef struct {
    State state;
    double step, error_before, event;
    double refused_length, refused_error;  /* of the last trial of a step that goes on; length 0: none */
    double *sizes, *lasting;  /* (L,) */
    double found;
    int left, rejected, n_grids;
    Grid *grids;              /* those that judge steps */
} Memory;

/* What follows from the coupling and the system once and for all. */
typedef struct {
    int iterates;             /* hermite; else derivative */
    int highest, chooses, accelerates, max_iterations;
    int iterations;           /* plain ones, exactly so many; 0: as many as it takes */
    int saves, halves, sequential, exchanges;
    double tolerance, accuracy, unsettled, horizon;
    double first_change;      /* share of its size by which an input may change over a first step */
    ptrdiff_t n_back;         /* links that are fed back: n = 2 n_back unknowns */
    const ptrdiff_t *back;
    double *work;             /* of work_size(L, n) numbers */
} Plan;

/* A trial of a step takes 14 L + 6 n + n^2 of it; then come the states of up to three trials, and what
   halving compares. */
enum { TRIALS = 3 };
static size_t trial_size(size_t L, size_t n) { return 14 * L + 6 * n + n * n; }
static size_t state_size(size_t L, size_t n) { return 2 * KEPT * L + n * n; }
EXPORT size_t work_size(size_t L, size_t n) {
    return trial_size(L, n) + TRIALS * state_size(L, n) + 4 * L;
}

/* `interpolation` of polynomial.py: weights of value and derivative at `at`, (2, 2 n). */
static void interpolate(const double *nodes, int n, double at, double *weights) {
    for (int i = 0; i < n; i++) {
        double lagrange = 1.0, slope = 0.0, own_slope = 0.0;
        for (int j = 0; j < n; j++) {
            if (j == i) continue;
            const double gap = nodes[i] - nodes[j], factor = (at - nodes[j]) / gap;
            slope = slope * factor + lagrange / gap;
            lagrange *= factor;
            own_slope += 1.0 / gap;
        }
        const double square = lagrange * lagrange, square_slope = 2.0 * lagrange * slope;
        const double tilt = 1.0 - 2.0 * own_slope * (at - nodes[i]);
        weights[i] = tilt * square;
        weights[2 * n + i] = tilt * square_slope - 2.0 * own_slope * square;
        weights[n + i] = (at - nodes[i]) * square;
        weights[3 * n + i] = (at - nodes[i]) * square_slope + square;
    }
}

/* `hermite` of polynomial.py, (4, 4) in rows of `width`. */
static void cubic(double h, double *M, int width) {
    const double a = 1.0 / h, b = 6.0 / (h * h), c = 2.0 * a * b;
    const double entries[4][4] = {{1.0, 0.0, 0.0, 0.0}, {0.0, 1.0, 0.0, 0.0},
                                  {-b, -4.0 * a, b, -2.0 * a}, {c, b, -c, b}};
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < width; j++) M[i * width + j] = j < 4 ? entries[i][j] : 0.0;
}

/* `matched` of polynomial.py, (4, 6). */
static void matched(double h, double g, double *M) {
    const double r = g / h, q = 1.0 + r;
    const double missed[2][6] = {
        {(2.0 * r - 1.0) * q * q, h * r * q * q, -r * r * (3.0 + 2.0 * r), h * r * r * q, 1.0, 0.0},
        {-6.0 * r * q, -h * q * (1.0 + 3.0 * r), 6.0 * r * q, -h * r * (2.0 + 3.0 * r), 0.0, h}};
    const double w = (r * q) * (r * q), slope = -2.0 * r * q * (1.0 + 2.0 * r);
    cubic(h, M, 6);
    for (int j = 0; j < 6; j++) {
        const double beta = (missed[1][j] - slope / w * missed[0][j]) / w;
        const double alpha = missed[0][j] / w + r * beta;
        const double A = -alpha / 15.0 - beta * (2.0 / 35.0);
        const double B = alpha * (2.0 / 3.0) + beta * (3.0 / 7.0);
        M[j] += A;
        M[6 + j] += (B - 2.0 * A) / h;
        M[12 + j] += 2.0 * (A - 2.0 * B) / (h * h);
        M[18 + j] += 6.0 * B / (h * h * h);
    }
}

/* `differentiation` of polynomial.py: weights of value and derivative at `at` of the polynomial through
   the nodes, (n,) each. */
static void differentiate(const double *nodes, int n, double at, double *value, double *slope) {
    double product = 1.0, distance = nodes[0] - at;
    memset(value, 0, (size_t)n * sizeof *value);
    memset(slope, 0, (size_t)n * sizeof *slope);
    value[0] = 1.0;
    for (int i = 1; i < n; i++) {
        const double previous = distance;
        double partial = 1.0;
        distance = nodes[i] - at;
        for (int j = 0; j < i; j++) {
            const double gap = nodes[i] - nodes[j];
            partial *= gap;
            if (j == i - 1) {
                slope[i] = product * (value[j] - previous * slope[j]) / partial;
                value[i] = -product * previous * value[j] / partial;
            }
            slope[j] = (distance * slope[j] - value[j]) / gap;
            value[j] = distance * value[j] / gap;
        }
        product = partial;
    }
}

/* Values and derivatives at `end` by the polynomials through the newest point and `n` before it. */
static void extrapolate(const State *state, ptrdiff_t L, double end, const int *back, int n,
                        double *found) {
    const double now = state->times[state->n_times - 1];
    double nodes[KEPT], weights[4 * KEPT];
    nodes[0] = 0.0;
    for (int i = 0; i < n; i++) nodes[1 + i] = state->times[state->n_times - 1 - back[i]] - now;
    interpolate(nodes, n + 1, end - now, weights);
    for (int row = 0; row < 2; row++)
        for (ptrdiff_t k = 0; k < L; k++) {
            double sum = 0.0;
            for (int kind = 0; kind < 2; kind++)
                for (int i = 0; i <= n; i++) {
                    const int place = KEPT - 1 - (i ? back[i - 1] : 0);
                    sum += weights[row * 2 * (n + 1) + kind * (n + 1) + i]
                         * state->table[(kind * KEPT + place) * L + k];
                }
            found[row * L + k] = sum;
        }
}

/* Points.predicted: value and derivative at `time` by the polynomial through a link's values. */
static void predict(const State *state, ptrdiff_t L, double time, ptrdiff_t k, double *value,
                    double *slope) {
    const int n = state->n_times;
    double nodes[KEPT] = {0.0}, of_value[KEPT], of_slope[KEPT];
    for (int i = 0; i < n; i++) nodes[i] = state->times[i] - time;
    differentiate(nodes, n, 0.0, of_value, of_slope);
    *value = *slope = 0.0;
    for (int i = 0; i < n; i++) {
        const double known = state->table[(KEPT - n + i) * L + k];
        *value += of_value[i] * known;
        *slope += of_slope[i] * known;
    }
}

/* LinkReader.end: the value of link k at the end of a step, and its derivative. Where the source says
   none, it comes from the values, and the one at the start is improved. */
static void read_end(const Loop *loop, const State *state, double end, ptrdiff_t k, double *at_start,
                     double *value, double *slope) {
    *value = loop->Y[loop->source[k]];
    if (loop->source_derivative[k] >= 0) {
        *slope = loop->Y[loop->source_derivative[k]];
        return;
    }
    const ptrdiff_t L = loop->n_links;
    const int n = state->n_times;
    double nodes[KEPT + 1], of_value[KEPT + 1], of_start[KEPT + 1], of_end[KEPT + 1];
    for (int i = 0; i < n; i++) nodes[i] = state->times[i] - end;
    nodes[n] = end - end;
    differentiate(nodes, n + 1, nodes[n - 1], of_value, of_start);
    differentiate(nodes, n + 1, 0.0, of_value, of_end);
    *at_start = *slope = 0.0;
    for (int i = 0; i <= n; i++) {
        const double known = i < n ? state->table[(KEPT - n + i) * L + k] : *value;
        *at_start += of_start[i] * known;
        *slope += of_end[i] * known;
    }
}

static int save(Loop *loop) {
    for (int m = 0; m < loop->n_slaves; m++) {
        const Slave *slave = &loop->slaves[m];
        loop->which = m;
        if (*slave->states[loop->level]) {
            *slave->note = slave->free_note;
            slave->free_state(slave->component, slave->states[loop->level]);
            loop->calls++;
        }
        *slave->states[loop->level] = NULL;
        loop->calls++;
        *slave->note = slave->get_note;
        const int status = slave->get_state(slave->component, slave->states[loop->level]);
        if (status > WARNING) return refused(loop, status, "fmi2GetFMUstate");
    }
    return DONE;
}

static int restore(Loop *loop) {
    for (int m = 0; m < loop->n_slaves; m++) {
        const Slave *slave = &loop->slaves[m];
        loop->which = m;
        loop->calls++;
        *slave->note = slave->set_note;
        const int status = slave->set_state(slave->component, *slave->states[loop->level]);
        if (status > WARNING) return refused(loop, status, "fmi2SetFMUstate");
    }
    return DONE;
}

/* The largest of `distance` relative to nominal value plus size. */
static double relative(const Loop *loop, const double *distance, const double *values) {
    double largest = 0.0;
    for (ptrdiff_t k = 0; k < loop->n_links; k++) {
        const double error = distance[k] / (loop->nominal[k] + fabs(values[k]));
        if (!(error <= largest)) largest = error;
    }
    return largest;
}

/* What a trial of a step leaves besides the FMUs' states. */
typedef struct {
    double error;
    int order;
} Trial;

static double sum_of_products(const double *row, const double *data, int n, ptrdiff_t L) {
    double sum = 0.0;
    for (int j = 0; j < n; j++) sum += row[j] * data[j * L];
    return sum;
}

/* Send the inputs of a slave values alone, and read what it puts out for them. */
static int read_for_values(Loop *loop, const Slave *slave, const double *values) {
    const ptrdiff_t L = loop->n_links;
    for (ptrdiff_t k = loop->columns[loop->which]; k < loop->columns[loop->which + 1]; k++) {
        loop->C[k] = values[k];
        loop->C[L + k] = loop->C[2 * L + k] = loop->C[3 * L + k] = 0.0;
    }
    return call_writes(loop, slave, slave->writes, slave->n_writes);
}

/* The state after a step to `end`; Points.followed. */
static void follow(const State *from, State *to, double end, const double *new, ptrdiff_t L) {
    const int drops = from->n_times == KEPT;
    to->n_times = from->n_times + !drops;
    memmove(to->times, from->times + drops, (size_t)(to->n_times - 1) * sizeof(double));
    to->times[to->n_times - 1] = end;
    for (int row = 0; row < 2; row++) {
        double *points = to->table + row * KEPT * L;
        memmove(points, from->table + (row * KEPT + 1) * L, (KEPT - 1) * (size_t)L * sizeof(double));
        memcpy(points + (KEPT - 1) * L, new + row * L, (size_t)L * sizeof(double));
    }
}

/* `attempt` of hermite.py: iterate until the ends that are fed back settle. `to` is the state at the end. */
static int attempt(Loop *loop, const Plan *plan, const State *from, State *to, double time, double end,
                   Trial *trial) {
    const ptrdiff_t L = loop->n_links, n = 2 * plan->n_back;
    double *predicted = plan->work, *expected = predicted + 2 * L, *data = expected + 2 * L;
    double *new = data + 6 * L, *distance = new + 2 * L;
    double *z = distance + 2 * L, *r = z + n, *z_before = r + n, *r_before = z_before + n;
    double *scales = r_before + n, *change_of = scales + n, *A = change_of + n, *J = to->J;
    const double h = end - time;
    double M[24];

    trial->error = INFINITY;
    trial->order = LOW;
    to->order = plan->highest;
    to->length = h;

    /* opened(): extrapolated ends, and the matrix from the data to C */
    int back[KEPT] = {0}, n_before = 0;
    for (int k = 1; k < from->n_times; k++)
        if (time - from->times[from->n_times - 1 - k] >= h / LONGEST_EXTRAPOLATION)
            back[n_before++] = k;
    extrapolate(from, L, end, back, n_before, predicted);
    const int is_high = n_before > 0 && from->order == HIGH;
    const int width = is_high ? 6 : 4;
    for (int row = 0; row < 2; row++)
        for (ptrdiff_t k = 0; k < L; k++) {
            data[row * L + k] = from->table[(row * KEPT + KEPT - 1) * L + k];
            data[(2 + row) * L + k] = predicted[row * L + k];
            if (is_high) data[(4 + row) * L + k] = from->table[(row * KEPT + KEPT - 1 - back[0]) * L + k];
        }
    for (ptrdiff_t k = 0; loop->inexact && k < L; k++)
        if (loop->source_derivative[k] < 0) {
            double value;
            predict(from, L, time, k, &value, &data[L + k]);
            predict(from, L, end, k, &data[2 * L + k], &data[3 * L + k]);
        }
    const double g = n_before ? time - from->times[from->n_times - 1 - back[0]] : 0.0;
    if (is_high) matched(h, g, M); else cubic(h, M, 4);

    for (ptrdiff_t i = 0; i < plan->n_back; i++) {
        scales[i] = fabs(data[plan->back[i]]) + loop->nominal[plan->back[i]];
        scales[plan->n_back + i] = scales[i] / h;
    }
    /* What an input's end does to an output grows with the step, to first order. */
    const double grown = from->length > 0.0 ? h / from->length : 1.0;
    for (ptrdiff_t i = 0; i < n * n; i++) J[i] = from->J[i] * grown;

    const int most = plan->iterations ? plan->iterations : plan->max_iterations;
    int settled = plan->iterations > 0;
    double change_before = INFINITY;
    for (int count = 1; count <= most; count++) {
        if (count > 1 && restore(loop)) return REFUSED;
        for (int m = 0; m < loop->n_slaves; m++) {
            const Slave *slave = &loop->slaves[m];
            loop->which = m;
            for (ptrdiff_t k = loop->columns[m]; k < loop->columns[m + 1]; k++) {
                const double *w = data + k;
                for (int row = 0; row < 4; row++)
                    loop->C[row * L + k] = sum_of_products(M + row * width, w, width, L);
                /* _lower(): the cubic's mean, the chord, the parabola */
                if (loop->order[k] == 0)
                    loop->C[k] = (w[0] + w[2 * L]) / 2.0 + (w[L] - w[3 * L]) * (h / 12.0);
                else if (loop->order[k] == 1)
                    loop->C[L + k] = (w[2 * L] - w[0]) / h;
                else if (loop->order[k] == 2)
                    loop->C[2 * L + k] = 2.0 * (w[2 * L] - w[0] - h * w[L]) / (h * h);
            }
            if (call_writes(loop, slave, slave->writes, slave->n_writes)) return REFUSED;
            *slave->note = slave->step_note;
            const int status = slave->step(slave->component, time, h, 1);
            if (status > WARNING) return refused(loop, status, "fmi2DoStep");
            if (call_reads(loop, slave)) return REFUSED;
            /* Outputs for the inputs' values at the end, not those held over the step. */
            if (slave->holds_some
                && (read_for_values(loop, slave, data + 2 * L) || call_reads(loop, slave)))
                return REFUSED;
            for (ptrdiff_t k = 0; k < L; k++) {
                read_end(loop, from, end, k, &data[L + k], &new[k], &new[L + k]);
                if (slave->forward[k]) {
                    data[2 * L + k] = new[k];
                    data[3 * L + k] = new[L + k];
                }
            }
        }
        loop->passes++;
        double sum = 0.0;
        for (ptrdiff_t i = 0; i < n; i++) {
            const ptrdiff_t k = plan->back[i % plan->n_back], row = i / plan->n_back;
            z[i] = data[(2 + row) * L + k] / scales[i];
            r[i] = (new[row * L + k] - data[(2 + row) * L + k]) / scales[i];
            sum += r[i] * r[i];
        }
        const double change = sqrt(sum);
        if (!isfinite(change)) return NOT_FINITE;
        const int accelerates = plan->accelerates && n;
        if (accelerates && count > 1) {
            for (ptrdiff_t i = 0; i < n; i++) {
                z_before[i] = z[i] - z_before[i];
                r_before[i] = r[i] - r_before[i];
            }
            learn(J, z_before, r_before, n, change_of);
        }
        memcpy(z_before, z, (size_t)n * sizeof *z);
        memcpy(r_before, r, (size_t)n * sizeof *r);
        if (!plan->iterations
            && (change <= plan->accuracy
                /* The FMUs' own accuracy may leave a change that no iteration betters. */
                || (change <= plan->unsettled && change > change_before / 2.0))) {
            settled = 1;
            break;
        }
        change_before = change;
        const int quasi = !plan->iterations && accelerates;
        if (quasi) quasi_newton(J, r, n, A, change_of);
        for (ptrdiff_t i = 0; i < n; i++) {
            const ptrdiff_t k = plan->back[i % plan->n_back], row = i / plan->n_back;
            data[(2 + row) * L + k] = quasi ? (z[i] + change_of[i]) * scales[i] : new[row * L + k];
        }
    }
    if (!settled) return DONE;  /* with an infinite error */
    follow(from, to, end, new, L);
    if (!L) { trial->error = 0.0; return DONE; }

    /* estimated_error() */
    if (!n_before) {
        for (ptrdiff_t k = 0; k < L; k++) {
            const double third = 2.0 * (data[k] - new[k]) + h * (data[L + k] + new[L + k]);
            distance[k] = fabs(third) * (4.0 / 27.0);
        }
        trial->error = relative(loop, distance, new);
        return DONE;
    }
    if (n_before == 1) memcpy(expected, predicted, 2 * (size_t)L * sizeof *expected);
    else extrapolate(from, L, end, back, 1, expected);
    const double hg = h + g;
    for (ptrdiff_t k = 0; k < L; k++) {
        const double value = fabs(new[k] - expected[k]) * (h * h / (16.0 * (hg * hg)));
        const double slope = fabs(new[L + k] - expected[L + k]) * (h * h * h / (32.0 * hg * (h + h + g)));
        distance[k] = value > slope ? value : slope;
    }
    const double low = relative(loop, distance, new);
    trial->error = low;
    if (plan->highest != HIGH || n_before < 2) return DONE;
    const double kk = time - from->times[from->n_times - 1 - back[1]];
    const double top = h * (h / 2.0 + g), bottom = hg * (h + kk);
    const double share = top * top / (16.0 * (bottom * bottom));
    const double per_slope = 2.0 * (1.0 / h + 1.0 / hg + 1.0 / (h + kk));
    for (ptrdiff_t k = 0; k < L; k++) {
        const double value = fabs(new[k] - predicted[k]) * share;
        const double slope = fabs(new[L + k] - predicted[L + k]) * (share / per_slope);
        const double quintic = value > slope ? value : slope, residue = RESIDUE * distance[k];
        distance[L + k] = quintic > residue ? quintic : residue;
    }
    const double high = relative(loop, distance + L, new);
    if (plan->chooses) {
        const double a = low / plan->tolerance, b = high / plan->tolerance;
        to->order = b == 0.0 || (a > 0.0 && LOW * log(b) < HIGH * log(a)) ? HIGH : LOW;
    }
    if (from->order == HIGH) {
        trial->error = high;
        trial->order = HIGH;
    }
    return DONE;
}

/* `_step` of derivative.py: inputs follow value and derivative at the start, and the cubic or the chord
   between both ends where their source has stepped already. */
static int extrapolated(Loop *loop, const Plan *plan, const State *from, State *to, double time,
                        double end, Trial *trial) {
    const ptrdiff_t L = loop->n_links;
    double *w = plan->work, *ends = w + 4 * L, *new = ends + 2 * L, *distance = new + 2 * L;
    const double h = end - time;
    double M[16];
    cubic(h, M, 4);
    for (ptrdiff_t k = 0; k < L; k++) {
        w[k] = from->table[(KEPT - 1) * L + k];
        w[L + k] = from->table[(2 * KEPT - 1) * L + k];
        if (loop->source_derivative[k] < 0) predict(from, L, time, k, &distance[k], &w[L + k]);
        loop->C[k] = loop->order[k] ? w[k] : w[k] + w[L + k] * (h / 2.0);
        loop->C[L + k] = w[L + k];
        loop->C[2 * L + k] = loop->C[3 * L + k] = 0.0;
        ends[k] = w[k] + w[L + k] * h;  /* where the input is expected to be */
    }
    for (int m = 0; m < loop->n_slaves; m++) {
        const Slave *slave = &loop->slaves[m];
        loop->which = m;
        for (ptrdiff_t k = loop->columns[m]; slave->steps_ahead && k < loop->columns[m + 1]; k++) {
            if (!slave->ahead[k]) continue;
            read_end(loop, from, end, k, &w[L + k], &w[2 * L + k], &w[3 * L + k]);
            ends[k] = w[2 * L + k];
            if (loop->order[k] == 0) loop->C[k] = (w[k] + w[2 * L + k]) / 2.0;
            else if (loop->order[k] < 3) loop->C[L + k] = (w[2 * L + k] - w[k]) / h;
            else
                for (int row = 0; row < 4; row++)
                    loop->C[row * L + k] = sum_of_products(M + row * 4, w + k, 4, L);
        }
        if (call_writes(loop, slave, slave->writes, slave->n_writes)) return REFUSED;
        *slave->note = slave->step_note;
        const int status = slave->step(slave->component, time, h, 1);
        if (status > WARNING) return refused(loop, status, "fmi2DoStep");
        if (slave->reaches_end && read_for_values(loop, slave, ends)) return REFUSED;
        if (plan->sequential && call_reads(loop, slave)) return REFUSED;
    }
    for (int m = 0; m < loop->n_slaves && !plan->sequential; m++)
        if (call_reads(loop, &loop->slaves[loop->which = m])) return REFUSED;
    if (plan->exchanges) {
        const int code = run_exchange(loop);
        if (code) return code;
    }
    loop->passes++;
    for (ptrdiff_t k = 0; k < L; k++) {
        read_end(loop, from, end, k, &w[L + k], &new[k], &new[L + k]);
        distance[k] = fabs(w[k] + h * w[L + k] - new[k]);
    }
    trial->error = relative(loop, distance, new);
    trial->order = 2;
    follow(from, to, end, new, L);
    return DONE;
}

/* A step for a trial, whatever the coupling. */
static int make(Loop *loop, const Plan *plan, const State *from, State *to, double time, double end,
                Trial *trial) {
    const int code = plan->iterates ? attempt(loop, plan, from, to, time, end, trial)
                                    : extrapolated(loop, plan, from, to, time, end, trial);
    return code == DONE && !is_finite(loop) ? NOT_FINITE : code;
}

/* -- steps made whole and in halves, as step_control.py ---------------------------------------------- */

enum { PROBED = 8 };
static const double SHARES = 2.0, LEAST_SHARE = 1e-2, PASSING_SHARE = 0.3, FLOOR_EXPONENT = 0.25;

/* The last trial of two, and the values of the links after the first, (L,). */
static int in_halves(Loop *loop, const Plan *plan, const State *from, State *middle, State *to,
                     double time, double end, Trial *trial, double *values) {
    const double between = time + (end - time) / 2.0;
    int code = make(loop, plan, from, middle, time, between, trial);
    for (ptrdiff_t k = 0; k < loop->n_links; k++) values[k] = loop->Y[loop->source[k]];
    if (code || !isfinite(trial->error)) return code;
    loop->level = 1;
    code = save(loop);
    if (!code) code = make(loop, plan, middle, to, between, end, trial);
    loop->level = 0;
    return code;
}

/* `halved`: the error of a step is what its halves, which are kept, differ by. */
static int halved(Loop *loop, const Plan *plan, Memory *memory, State *states, double time, double end,
                  Trial *trial) {
    const ptrdiff_t L = loop->n_links, n = 2 * plan->n_back;
    double *at_end = plan->work + trial_size((size_t)L, (size_t)n)
                   + TRIALS * state_size((size_t)L, (size_t)n);
    double *at_middle = at_end + L, *first_half = at_middle + L;
    const State *from = &memory->state;
    int probes = 0;
    int code = make(loop, plan, from, &states[0], time, end, trial);
    for (ptrdiff_t k = 0; k < L; k++) at_end[k] = loop->Y[loop->source[k]];
    if (code || !isfinite(trial->error)) return code;
    if (!memory->left) {
        if ((code = restore(loop))) return code;
        code = in_halves(loop, plan, from, &states[1], &states[0], time, time + (end - time) / 2.0,
                         trial, first_half);
        if (code) return code;
        probes = isfinite(trial->error);
        for (ptrdiff_t k = 0; k < L; k++) at_middle[k] = loop->Y[loop->source[k]];
    }
    if ((code = restore(loop))) return code;
    code = in_halves(loop, plan, from, &states[1], &states[0], time, end, trial, first_half);
    if (code || !L || !isfinite(trial->error)) return code;
    const double least = SHARES * (end - time) / plan->horizon;
    const double share = least > LEAST_SHARE ? least : LEAST_SHARE;
    double worst = 0.0;
    memory->found = 0.0;
    for (ptrdiff_t k = 0; k < L; k++) {
        const double found = loop->Y[loop->source[k]], difference = found - at_end[k];
        if (probes) {
            /* a h + b h^3 over the step, a h/2 + b h^3/8 over its half */
            const double lasting = fabs(difference - 2.0 * (at_middle[k] - first_half[k])) * (4.0 / 3.0);
            memory->lasting[k] = fabs(difference) > lasting ? lasting / fabs(difference) : 1.0;
        }
        const double size = memory->sizes[k] > fabs(found) ? memory->sizes[k] : fabs(found);
        const double error = fabs(difference) / 3.0 / (loop->nominal[k] + size);
        const double lasts = error * memory->lasting[k] / share, passes = error / PASSING_SHARE;
        if (error > memory->found) memory->found = error;
        if (lasts > worst) worst = lasts;
        if (passes > worst) worst = passes;
    }
    trial->error = worst;
    trial->order = share == LEAST_SHARE ? 3 : 2;
    return DONE;
}

/* Whether a shorter step than the one refused has hardly less of an error, which the run can bear. */
static int is_floor(const Memory *memory, double length, double tolerance) {
    const double ratio = length / memory->refused_length;
    return memory->found <= PASSING_SHARE * tolerance && ratio <= 0.5
        && memory->found > memory->refused_error * pow(ratio, FLOOR_EXPONENT);
}

static void accept_halves(const Loop *loop, Memory *memory) {
    memory->left = memory->left ? memory->left - 1 : PROBED;
    for (ptrdiff_t k = 0; k < loop->n_links; k++) {
        const double size = fabs(loop->Y[loop->source[k]]);
        if (size > memory->sizes[k]) memory->sizes[k] = size;
    }
}

/* -- the loop over time --------------------------------------------------------------------------------- */

/* `unresolved` of Session and OutputGrid: above 1, the step to `end`, which has been made, is too long
   for what is recorded in it. */
static double unresolved(const Loop *loop, const Memory *memory, double end) {
    double surprise = 0.0;
    for (int g = 0; g < memory->n_grids; g++) {
        const Grid *grid = &memory->grids[g];
        const int n = grid->n_times;
        if (end - grid->times[n - 1] <= grid->interval) continue;
        double weights[NODES], slopes[NODES], amplified = INFINITY;
        int first = -1;
        while (amplified > MOST_AMPLIFIED) {  /* that of the newest value alone is 1 */
            first++;
            differentiate(grid->times + first, n - first, end, weights, slopes);
            amplified = 0.0;
            for (int i = 0; i < n - first; i++) amplified += fabs(weights[i]);
        }
        for (ptrdiff_t k = 0; k < grid->n_sampled; k++) {
            double predicted = 0.0;
            for (int i = 0; i < n - first; i++)
                predicted += weights[i] * grid->samples[(first + i) * grid->n_sampled + k];
            const double found = loop->Y[grid->places[k]];
            const double size = fabs(predicted) > fabs(found) ? fabs(predicted) : fabs(found);
            const double error = fabs(found - predicted) / (grid->nominal[k] + size);
            if (error > surprise) surprise = error;
        }
    }
    return surprise / SAMPLED_TOLERANCE;
}

/* A communication point, as OutputGrid.point. */
static void sample(const Loop *loop, Memory *memory, double time) {
    for (int g = 0; g < memory->n_grids; g++) {
        Grid *grid = &memory->grids[g];
        const ptrdiff_t S = grid->n_sampled;
        if (grid->n_times == NODES) {
            grid->n_times--;
            memmove(grid->times, grid->times + 1, (NODES - 1) * sizeof(double));
            memmove(grid->samples, grid->samples + S, (NODES - 1) * (size_t)S * sizeof(double));
        }
        grid->times[grid->n_times] = time;
        for (ptrdiff_t k = 0; k < S; k++)
            grid->samples[grid->n_times * S + k] = loop->Y[grid->places[k]];
        grid->n_times++;
    }
}

static double end_of(double time, double length, double target) {
    const double left = target - time;
    if (left <= STRETCH * length) return target;
    return time + (left < 2.0 * length ? left / 2.0 : length);
}

/* `start` of a coupling after a jump, and the first step from there. */
static void restart(const Loop *loop, const Plan *plan, Memory *memory, double time) {
    const ptrdiff_t L = loop->n_links;
    double rate = 0.0;
    State *state = &memory->state;
    state->times[0] = time;
    state->n_times = 1;
    state->order = plan->highest;
    memset(state->table, 0, 2 * KEPT * (size_t)L * sizeof(double));
    for (ptrdiff_t k = 0; k < L; k++) {
        const ptrdiff_t place = loop->source_derivative[k];
        const double value = loop->Y[loop->source[k]], slope = place < 0 ? 0.0 : loop->Y[place];
        state->table[(KEPT - 1) * L + k] = value;
        state->table[(2 * KEPT - 1) * L + k] = slope;
        const double change = fabs(slope) / (loop->nominal[k] + fabs(value));
        if (change > rate) rate = change;
    }
    const double first = rate > 0.0 ? 1.0 / rate * plan->first_change : INFINITY;
    if (first < memory->step) memory->step = first;
    memory->error_before = 1.0;
    memory->rejected = 0;
    for (int g = 0; g < memory->n_grids; g++) memory->grids[g].n_times = 0;
}

/* Where the states of trials are. */
static void lay_out(const Loop *loop, const Plan *plan, State *states) {
    const size_t L = (size_t)loop->n_links, n = 2 * (size_t)plan->n_back;
    for (int i = 0; i < TRIALS; i++) {
        states[i].table = plan->work + trial_size(L, n) + (size_t)i * state_size(L, n);
        states[i].J = states[i].table + 2 * KEPT * L;
    }
}

/* A trial becomes the state. */
static void take(const Loop *loop, const Plan *plan, const State *from, State *to) {
    const size_t L = (size_t)loop->n_links, n = 2 * (size_t)plan->n_back;
    memcpy(to->times, from->times, sizeof to->times);
    to->n_times = from->n_times;
    memcpy(to->table, from->table, 2 * KEPT * L * sizeof(double));
    if (!plan->iterates) return;
    memcpy(to->J, from->J, n * n * sizeof(double));
    to->order = from->order;
    to->length = from->length;
}

/* Steps from *time on to the stop time, chosen by the tolerance, over the jumps, the first of which is at
   `memory->event`.
   On UNUSUAL the FMUs are where the step began, and Python makes it. On NOT_FINITE and UNSOLVED a jump,
   at `memory->event`, has led there. */
EXPORT int run_adaptive(Loop *loop, const Plan *plan, Memory *memory, double *time) {
    State states[TRIALS];
    lay_out(loop, plan, states);
    loop->level = 0;
    while (*time < loop->stop) {
        const double event = memory->event, before = just_before(event);
        const double target = before < loop->stop ? before : loop->stop;
        if (!has_room(loop)) return FULL;
        if (*time >= target) {
            const int code = cross(loop, *time, event);
            if (code) return code;
            *time = event;
            restart(loop, plan, memory, event);
            sample(loop, memory, event);
            memory->event = next_event(loop, event);
            if (counted(loop, event)) return FULL;
            continue;
        }
        loop->time = *time;
        const long before_saving = loop->calls;
        if (save(loop)) return REFUSED;
        const long saving = loop->calls - before_saving;
        memory->refused_length = 0.0;
        double end;
        for (;;) {
            end = end_of(*time, memory->step, target);
            const double length = end - *time;
            Trial trial;
            const long calls = loop->calls, passes = loop->passes;
            const int code = plan->halves
                ? halved(loop, plan, memory, states, *time, end, &trial)
                : make(loop, plan, &memory->state, &states[0], *time, end, &trial);
            double scaled = trial.error / plan->tolerance;
            const int fits = code == DONE && scaled <= 1.0;
            if (fits) {
                /* A step may be good for the loop and too long for what is recorded in it. */
                const double recorded = unresolved(loop, memory, end);
                if (recorded > scaled) scaled = recorded;
                memory->refused_length = 0.0;
            }
            const double size = fabs(*time) > fabs(end) ? fabs(*time) : fabs(end);
            const double rounding = SMALLEST_STEP * unit_in_the_last_place(size);
            const double share = SMALLEST_SHARE * plan->horizon;
            const int smallest = length <= (rounding > share ? rounding : share);
            int accepted = fits && scaled <= 1.0;
            if (accepted) {
                /* StepSize.accepted */
                const double error = scaled > SMALLEST_ERROR ? scaled : SMALLEST_ERROR;
                double change = SAFETY * pow(error, -INTEGRAL / trial.order)
                              * pow(memory->error_before, PROPORTIONAL / trial.order);
                const double largest = memory->rejected ? 1.0 : LARGEST_CHANGE;
                change = change > SMALLEST_CHANGE ? change : SMALLEST_CHANGE;
                change = change < largest ? change : largest;
                memory->step = length * change;
                memory->error_before = error;
                memory->rejected = 0;
            } else if (code == DONE && !fits && !smallest && plan->halves) {
                accepted = memory->refused_length > 0.0 && is_floor(memory, length, plan->tolerance);
                if (accepted) {
                    /* What is left comes from the FMUs, whose accuracy no step betters. */
                    loop->floors++;
                    memory->step = memory->refused_length;
                    memory->rejected = 1;
                } else {
                    memory->refused_length = length;
                    memory->refused_error = memory->found;
                }
            }
            if (accepted) {
                if (trial.error > loop->largest_error) loop->largest_error = trial.error;
                if (plan->halves) accept_halves(loop, memory);
                take(loop, plan, &states[0], &memory->state);
                break;
            }
            if (restore(loop)) return REFUSED;
            if (code != DONE || (!fits && smallest)) {
                loop->calls = calls - saving;  /* which are made, and counted, once more */
                loop->passes = passes;
                return UNUSUAL;
            }
            /* StepSize.refused */
            double change = SMALLEST_CHANGE;
            if (isfinite(scaled)) {
                change = SAFETY * pow(scaled, -1.0 / trial.order);
                change = change > SMALLEST_CHANGE ? change : SMALLEST_CHANGE;
                change = change < SAFETY ? change : SAFETY;
            }
            memory->step = length * change;
            memory->rejected = 1;
            loop->rejected++;
        }
        *time = end;
        if (end < target || event == INFINITY) {
            record(loop, end, POINT);
            sample(loop, memory, end);
            if (counted(loop, end)) return FULL;
        }
    }
    return DONE;
}

/* Steps of `derivative` and `hermite` from *time on to each of `count` points. `before`, (2, L): values
   and derivatives of the links at the beginning; afterwards those at the end.
   On UNUSUAL the FMUs are where the step began, and Python makes it. */
EXPORT int run_points(Loop *loop, const Plan *plan, Memory *memory, double *time, const double *points,
                      long count, double *before) {
    const ptrdiff_t L = loop->n_links;
    State states[TRIALS], *state = &memory->state;
    lay_out(loop, plan, states);
    loop->level = 0;
    for (long k = 0; k < count; k++) {
        if (!has_room(loop)) return FULL;
        const double end = points[k], length = end - *time;
        loop->time = *time;
        const long calls = loop->calls, passes = loop->passes;
        if (plan->saves && save(loop)) return REFUSED;
        Trial trial;
        const int code = plan->iterates
            ? attempt(loop, plan, state, &states[0], *time, end, &trial)
            : extrapolated(loop, plan, state, &states[0], *time, end, &trial);
        if (plan->saves && (code || !isfinite(trial.error))) {
            if (restore(loop)) return REFUSED;
            loop->calls = calls;  /* which are made, and counted, once more */
            loop->passes = passes;
            return UNUSUAL;
        }
        if (code) return code;
        take(loop, plan, &states[0], state);
        const double *new = state->table + (KEPT - 1) * L, *slopes = new + KEPT * L;
        if (plan->iterates) {
            if (trial.error > loop->largest_error) loop->largest_error = trial.error;
        } else
            /* Watch of base.py: how far inputs were from where they were extrapolated to. */
            for (ptrdiff_t i = 0; i < L; i++) {
                const double change = (new[i] - before[i]) - length * before[L + i];
                const double error = fabs(change) / (loop->nominal[i] + fabs(new[i]));
                if (error > loop->largest_error) loop->largest_error = error;
                before[i] = new[i];
                before[L + i] = slopes[i];
            }
        if (!is_finite(loop)) return NOT_FINITE;
        record(loop, end, POINT);
        counted(loop, end);
        *time = end;
    }
    return DONE;
}
