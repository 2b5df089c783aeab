/* What the parts of a native FMU share: the generated tables of a model, and one instance of it.

   A native FMU is the twin of the Python FMU that fmu_src/python makes of the same spec: the
   operations are the same, in the same order, so that the numbers are equal to the last bit.
   Nothing here is global but constants: instances may run in parallel threads. */

#ifndef CONGELATION_BLOCK_H
#define CONGELATION_BLOCK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "fmi2Functions.h"
#include "names.h"

/* Only the functions of FMI are seen from outside, whatever the compiler was asked for. */
#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

/* -- a model, generated ----------------------------------------------------------------------- */

enum role { INPUT, CONSTANT, OUTPUT, DERIVATIVE, GAIN, THETA, NEXT_EVENT, RATE };
enum domain { REAL, POSITIVE, NONNEGATIVE, POSITIVE_DEFINITE, BOOLEAN, SIGN };

/* `index` counts within the role; of a constant it is the place in the array of constants. */
struct variable {
    const char *name;
    char type; /* R, I, B or S */
    enum role role;
    int index;
    double start;
};

/* Values of a parameter: a vector, or a matrix row by row. */
struct parameter {
    const char *name;
    enum domain domain;
    int reference, count, columns;
};

/* How many terms of a kind a profile has room for, and the constants that hold their fields. */
struct profile_slots {
    const char *name;
    int mean;
    int sines, sine;           /* amplitude, omega, phase of each */
    int squares, square;       /* amplitude, period, phase */
    int chirps, chirp;         /* amplitude, omega_start, omega_end, duration, phase */
    int telegraphs, telegraph; /* amplitude, rate, seed */
    int noises, noise;         /* deviation, sample_time, seed */
    int file, linear;          /* of a table, -1 without room for one */
    const char *start_file;
};

extern const char MODEL_GUID[];
extern const unsigned char MODEL_KEY[32]; /* of serialised states */
extern const int VARIABLE_COUNT, STATES, INPUTS, OUTPUTS, DERIVATIVES, GAINS, PROFILES;
extern const int CONSTANTS, PARAMETERS;
extern const int LEAVE_AT_JUMPS; /* a constant, or -1 */
/* How many inputs are delayed, and the constants for it: the delay, the outputs before the first
   inputs come out, and how many steps are remembered at most. */
extern const int DELAYED, DELAY, BEFORE, CAPACITY;
extern const bool TIMED; /* the equations take time behind signals, and the slopes of signals */
extern const struct variable VARIABLES[];
extern const struct parameter MODEL_PARAMETERS[];
extern const int START_CONSTANTS[];       /* of the states */
extern const int OUTPUT_OF_DERIVATIVE[];  /* outputs whose time derivatives the FMU knows */
extern const fmi2ValueReference STATE_REFERENCES[];
extern const struct profile_slots PROFILE_SLOTS[];
extern const size_t BOUND_SIZE;

struct reason { char text[400]; };
enum outcome { COMPUTED, INFEASIBLE, UNCOMPUTABLE };

enum outcome model_gains(const double *parameters, double *gains, struct reason *why);
void model_bind(const double *parameters, const double *gains, void *bound);
void model_rates(const void *bound, const double *x, const double *v, const double *theta,
                 double *result);
void model_outputs(const void *bound, const double *x, const double *v, const double *theta,
                   double *result);
void model_derivatives(const void *bound, const double *x, const double *v, const double *d,
                       const double *theta, double *result);
/* Derivatives of rates, outputs and derivatives of outputs, one behind the other, in the direction
   of seeds of x, v, d and theta. */
void model_tangents(const void *bound, const double *x, const double *v, const double *d,
                    const double *theta, const double *x_seed, const double *v_seed,
                    const double *d_seed, const double *theta_seed, double *result);

/* What the equations are written with; as Python's functions, the first of equal operands. */
static inline double lesser(double a, double b) { return b < a ? b : a; }
static inline double greater(double a, double b) { return b > a ? b : a; }
static inline double sign_of(double a) { return (double)(a > 0.0) - (double)(a < 0.0); }

/* -- gains.c ---------------------------------------------------------------------------------- */

/* A rule: order n, m columns of B, the parameters that it takes, fixed matrices. */
typedef enum outcome rule(int n, int m, const double *const *arguments, const double *const *fixed,
                          double *gains, struct reason *why);
rule rule_iss_filter_gain, rule_hurwitz_filter_gain, rule_filter_norm, rule_matched_riccati;
bool is_positive_definite(const double *a, int n);
double exact_sum(const double *terms, int count);

/* -- profiles.c ------------------------------------------------------------------------------- */

enum kind { SQUARE, CHIRP, TELEGRAPH, NOISE };

/* One piece of a term between two events. */
struct piece {
    double start, end, held;
    bool smooth, sweeping; /* whether a sine, or a chirp in its sweep, is added */
    double wave[4];        /* amplitude, omega, [kappa,] phase */
};

/* A term with events; the telegraph's jumps are remembered around the time last asked for. */
struct term {
    enum kind kind;
    char name[16];
    double a, b, c, d, e;
    int64_t jumps;
    double last, next;
};

typedef double sine[3]; /* amplitude, omega, phase */

/* Values at given times, from a file: held from each time to the next, or joined by lines. */
struct table {
    int count;
    bool linear;
    double *times, *values;
    double start, held, slope; /* of the piece last asked for */
};

/* A profile: what holds at all times, and terms with events; the level is all that is constant on the
   piece last found. */
struct profile {
    double held, start, level;
    struct table table;
    int sine_count, term_count;
    sine *sines;
    struct term *terms;
    struct piece *pieces;
};

/* All profiles on one smooth piece, and their values at the times last asked for, as sines take most
   of a step: a step begins where the one before ended, outputs are read there, and a master that
   iterates makes the same step again. Each time has one place, which the next time there takes over;
   NaN is the time of an empty place. */
enum { REMEMBERED = 32 };
struct smooth {
    double start, end;
    bool known;
    double times[REMEMBERED], *values; /* PROFILES values at each time */
};

bool profile_bind(struct profile *profile, const struct profile_slots *slots,
                  const double *constants, const char *file, struct reason *why);
bool profile_segment(struct profile *profile, double t, double *start, double *end,
                     struct reason *why);
double profile_value(const struct profile *profile, double t);
double profile_derivative(const struct profile *profile, double t);

/* table.c: the rows of a CSV file; none of a file called "". */
bool table_read(struct table *table, const char *name, struct reason *why);
void table_free(struct table *table);
void table_piece(struct table *table, double t, double *start, double *end);

/* -- an instance ------------------------------------------------------------------------------ */

/* Of model exchange: EVENT and CONTINUOUS in place of STEPPING. */
enum mode { INSTANTIATED, INITIALIZATION, STEPPING, EVENT, CONTINUOUS, TERMINATED };

/* The complete state is one array of doubles: these, then x, the inputs and the constants; behind
   them the names of files of tables, FILE_SIZE bytes for each profile; in a saved state also PIECES
   pieces of the memory of a delay, oldest first. KIND is
   fmi2Type. EVENT_TIME is where model exchange last looked for the smooth piece of the profiles,
   which holds until it does so again: solvers evaluate at the very end of a piece, and behind it. */
enum scalar {
    MODE, TIME, HAS_STOP, STOP_TIME, TOLERANCE, INNER_STEP, SINCE, KIND, EVENT_TIME, PIECES, SCALARS
};

/* A piece of the memory of a delay: one step, whether the inputs jump at its start, their largest
   value until then, and behind these the cubic of each input. */
enum piece_field { START, LENGTH, JUMPS, LARGEST, CUBICS };
/* Of which the memory is a ring. */
struct ring {
    double *pieces;
    size_t capacity, first;
};

struct instance {
    const fmi2CallbackFunctions *callbacks;
    char *name;
    bool logging, refused_tolerance;
    /* the state */
    double *state, *x, *inputs, *constants;
    char *files;
    /* what follows from the constants */
    bool settled, is_bound;
    double *gains, *candidate_gains;
    void *bound;
    struct profile *profiles;
    struct smooth smooth;
    struct ring ring;
    /* what follows from the state */
    bool cubics_known, values_known, outputs_known, derivatives_known, rates_known;
    double *outputs, *derivatives, *rates;
    /* work: rates of the stages, points, values of inputs and theta */
    double *k, *y, *point, *v, *slopes, *theta, *cubics, *old_x, *seeds, *tangents;
    struct reason parameter_fault;
};

static inline size_t state_length(void)
{
    return (size_t)SCALARS + (size_t)STATES + (size_t)(4 * INPUTS)
           + (TIMED ? 0u : (size_t)PROFILES) + (size_t)CONSTANTS;
}

enum { FILE_SIZE = 512 };

/* What the equations take for theta: profiles or delayed inputs, and with TIMED time behind them. */
static inline int signals(void) { return PROFILES + DELAYED; }
static inline size_t piece_length(void) { return CUBICS + 4u * (size_t)DELAYED; }
static inline size_t files_size(void) { return (size_t)PROFILES * FILE_SIZE; }
static inline size_t state_size(void)
{
    return state_length() * sizeof(double) + files_size();
}
static inline size_t saved_size(const double *state)
{
    return state_size() + (size_t)state[PIECES] * piece_length() * sizeof(double);
}
static inline double *pieces_of(double *state) { return state + state_size() / sizeof(double); }
static inline const char *files_of(const double *state)
{
    return (const char *)(state + state_length());
}

static inline enum mode mode_of(const struct instance *in) { return (enum mode)in->state[MODE]; }
static inline bool exchanges(const struct instance *in)
{
    return in->state[KIND] == (double)fmi2ModelExchange;
}

/* log.c */
void report(const struct instance *instance, fmi2Status status, const char *format, ...);
fmi2Status illegal(const struct instance *instance, const char *function);
void explain(struct reason *why, const char *format, ...);
const char *repr_of(double value, char text[32]);

/* parameters.c: check the parameters, compute the gains, close the equations over both. */
bool settle(struct instance *instance);

/* variables.c */
bool theta_at(struct instance *instance, double t, struct reason *why);
void theta_values(struct instance *instance, double t);
void input_cubics(struct instance *instance);
bool values_now(struct instance *instance, bool slopes, struct reason *why);
bool computed_value(struct instance *instance, const struct variable *variable, double *value);
bool computed_rates(struct instance *instance);
void forget_computed(struct instance *instance);
void forget_inputs(struct instance *instance);

/* delay.c: the memory of a delay, in place of states. */
bool ring_open(struct instance *instance, struct reason *why);
void ring_copy(const struct instance *instance, double *pieces);
void ring_set(struct instance *instance, const double *pieces, size_t count);
void delayed_values(struct instance *instance, bool slopes);
double delayed_event(struct instance *instance);
bool delayed_step(struct instance *instance, double t, double h, struct reason *why);

/* integrator.c: x from t over h; false, with x and the inner step undone by the caller. */
bool advance(struct instance *instance, double t, double h, struct reason *why);

/* state.c: the complete state as bytes, the same on every machine */
size_t serialized_size(const double *state);
void serialize(const double *state, unsigned char *bytes);
/* A new state; NULL, and what is wrong, otherwise. */
double *deserialize(const unsigned char *bytes, size_t size, const char **fault);

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
