/* What the loop works on: the structures that congelation/cosim/compiled/structures.py mirrors.

   Symbols as in ensemble.py: Y is all that is read; C, of shape (4, L), the polynomials of the inputs,
   u(t + s) = C[0] + C[1] s + C[2] s^2/2 + C[3] s^3/6. */

#ifndef CONGELATION_LOOP_STRUCTURES_H
#define CONGELATION_LOOP_STRUCTURES_H

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
enum { DONE, FULL, REFUSED, NOT_FINITE, UNUSUAL, UNSOLVED,       /* why a run of steps ended; */
       TOO_SMALL, CROSSED, TERMINATED, UNSETTLED, LATE };  /* the others by model exchange alone */
enum { POINT, BEFORE_JUMP, AFTER_JUMP, VISITED };     /* what a row is of */

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
    ptrdiff_t n_judged;       /* values that steps in halves are judged by: the links, and what is */
    const ptrdiff_t *judged;  /* recorded besides; their places in Y */
    const double *judged_nominal;
} Loop;

enum { KEPT = 3, NODES = 6 };

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

/* What a run takes from one step to the next besides; StepSize and Halving of step_size.py. */
typedef struct {
    State state;
    double step, error_before, event;
    double refused_length, refused_error;  /* of the last trial of a step that goes on; length 0: none */
    double *sizes, *lasting;  /* (n_judged,) */
    double found, estimate, jump, kink;
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
    double shortest_kept;     /* step that Python keeps whatever its error; 0 where it keeps none */
    double longest_at_rest;   /* step after one without an error; infinity where there is no bound */
    ptrdiff_t n_back;         /* links that are fed back: n = 2 n_back unknowns */
    const ptrdiff_t *back;
    double *work;             /* of work_size(L, n) numbers */
} Plan;

typedef struct {              /* fmi2EventInfo */
    int again, ends, nominals_changed, states_changed, has_event;
    double event;
} DiscreteStates;

/* An FMU of model exchange, besides its Slave. */
typedef struct {
    int (*set_time)(void *, double);
    int (*set_states)(void *, const double *, size_t);
    int (*get_rates)(void *, double *, size_t);
    int (*get_indicators)(void *, double *, size_t);
    int (*completed)(void *, int, int *, int *);  /* NULL: it need not be called */
    int (*enter_event)(void *), (*enter_continuous)(void *);
    int (*new_states)(void *, DiscreteStates *);
    int (*get_states)(void *, double *, size_t);
    int (*get_nominals)(void *, double *, size_t);
    uint64_t time_note, states_note, rates_note, indicators_note, completed_note, event_note;
    size_t n_states, n_indicators;
    ptrdiff_t first;          /* of its states in x */
    unsigned char *positive;  /* (n_indicators,): which were so after the last event */
} Part;

/* All states of a system, and the method that integrates them: see dop853.c. */
typedef struct {
    Loop *drive;              /* the values that drive inputs, and nothing else */
    const Part *parts;
    ptrdiff_t n;
    double *nominal;          /* (n,) */
    double tolerance, step;   /* step 0: it is to be chosen */
    const double *A, *B, *C, *E3, *E5, *D, *A_extra, *C_extra;
    double *x, *x_old, *x_new;
    double *K, *F, *work;     /* (16, n), (7, n), (2 n,) */
    double *indicators;       /* of the FMU that has the most */
    double t_old, largest, event;  /* `event`: the next announced one; infinite: none */
    double *Y_before;         /* (n_Y,): all that was read before discrete states changed */
    ptrdiff_t n_Y;
    double leaves;            /* change of what is read that counts as none; see `settled` */
    const double *visits;     /* times at which rows are asked for, beyond the start */
    double near;              /* a visit this near to the end of a step is there */
    long n_visits, visited, rejected;
    int more;                 /* whether there are more of them */
    int restarts, is_dense;   /* f at *time is not known; F is that of the last step */
    int reached, displaced;   /* its rows are still to be made; the FMUs are not at its end */
    int ended;                /* the FMU that wants no further step, or announces an event too late */
    int in_event;             /* an event was being made */
} Integrator;

#endif
