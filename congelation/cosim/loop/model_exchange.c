/* All states of a system integrated as one differential equation, by FMI 2.0 model exchange. Between two
   events this goes without returning to Python, which makes events and says what ends a run. */

#include "dop853.c"

/* A status above fmi2Warning; one that lets a shorter step be tried is no refusal. */
enum { DISCARD = 2 };

/* Give the FMUs time and states, and carry outputs over to inputs. */
static int set_point(Integrator *in, double t, const double *x) {
    Loop *drive = in->drive;
    for (int m = 0; m < drive->n_slaves; m++) {
        const Part *part = &in->parts[drive->which = m];
        const Slave *slave = &drive->slaves[m];
        *slave->note = part->time_note;
        int status = part->set_time(slave->component, t);
        if (status > WARNING) return refused(drive, status, "fmi2SetTime");
        if (!part->n_states) continue;
        *slave->note = part->states_note;
        status = part->set_states(slave->component, x + part->first, part->n_states);
        if (status == DISCARD) return UNUSUAL;
        if (status > WARNING) return refused(drive, status, "fmi2SetContinuousStates");
    }
    return carry(drive);
}

/* dx/dt; not a number where states are not finite, or an FMU discards them: the step is too long. */
static int rates(Integrator *in, double t, const double *x, double *f) {
    Loop *drive = in->drive;
    int code = DONE;
    drive->time = t;
    for (ptrdiff_t i = 0; i < in->n; i++)
        if (!isfinite(x[i])) code = UNUSUAL;
    if (!code) {
        drive->passes++;
        code = set_point(in, t, x);
    }
    for (int m = 0; !code && m < drive->n_slaves; m++) {
        const Part *part = &in->parts[drive->which = m];
        const Slave *slave = &drive->slaves[m];
        if (!part->n_states) continue;
        *slave->note = part->rates_note;
        const int status = part->get_rates(slave->component, f + part->first, part->n_states);
        if (status == DISCARD) code = UNUSUAL;
        else if (status > WARNING) code = refused(drive, status, "fmi2GetDerivatives");
    }
    if (code != UNUSUAL) return code;
    for (ptrdiff_t i = 0; i < in->n; i++) f[i] = NAN;
    return DONE;
}

EXPORT int integrator_rates(Integrator *in, double t, const double *x, double *f) {
    return rates(in, t, x, f);
}

EXPORT int integrator_states(Integrator *in, double time, double at, double *x) {
    return states_within(in, time, at, x);
}

/* Whether an event indicator has changed its sign; FMI 2.0, 3.1.1: z > 0 against z <= 0. */
static int crossed(Integrator *in, int *code) {
    Loop *drive = in->drive;
    int found = 0;
    for (int m = 0; m < drive->n_slaves; m++) {
        const Part *part = &in->parts[drive->which = m];
        const Slave *slave = &drive->slaves[m];
        if (!part->n_indicators) continue;
        *slave->note = part->indicators_note;
        const int status = part->get_indicators(slave->component, in->indicators, part->n_indicators);
        if (status > WARNING) { *code = refused(drive, status, "fmi2GetEventIndicators"); return 0; }
        for (size_t k = 0; k < part->n_indicators; k++)
            found |= (in->indicators[k] > 0.0) != part->positive[k];
    }
    return found;
}

/* A point, all that is recorded being read. */
static int read_point(Loop *loop) {
    for (int m = 0; m < loop->n_slaves; m++) {
        loop->which = m;
        loop->calls += loop->slaves[m].n_reads;
        if (call_reads(loop, &loop->slaves[m])) return REFUSED;
    }
    return is_finite(loop) ? DONE : NOT_FINITE;
}

/* Rows of the last step, which ended at `time`: at times asked for within it, and at its end. */
static int reach(Loop *loop, Integrator *in, double time, int is_event, int *full) {
    int code;
    for (; in->visited < in->n_visits && in->visits[in->visited] < time; in->visited++) {
        const double at = in->visits[in->visited];
        if (!has_room(loop)) return FULL;
        in->displaced = 1;
        if ((code = states_within(in, time, at, in->x_new))) return code;
        if ((code = set_point(in, loop->time = at, in->x_new))) return code;
        if ((code = read_point(loop))) return code;
        record(loop, at, VISITED);
    }
    if ((in->more && in->visited == in->n_visits) || !has_room(loop)) return FULL;
    if (in->displaced && (code = set_point(in, time, in->x))) return code;
    in->displaced = 0;
    loop->time = time;
    int asks = 0, ends = 0;
    for (int m = 0; m < loop->n_slaves; m++) {
        const Part *part = &in->parts[loop->which = m];
        const Slave *slave = &loop->slaves[m];
        int enter = 0, terminate = 0;
        if (!part->completed) continue;
        *slave->note = part->completed_note;
        loop->calls++;
        const int status = part->completed(slave->component, 1, &enter, &terminate);
        if (status > WARNING) return refused(loop, status, "fmi2CompletedIntegratorStep");
        if (terminate && !ends++) in->ended = m;
        asks |= enter;
    }
    in->reached = 0;
    if ((code = read_point(loop))) return code;
    if (!ends && (asks || is_event)) return asks ? EVENT : DONE;
    record(loop, time, POINT);
    *full = counted(loop, time);
    return ends ? TERMINATED : DONE;
}

/* From *time to `target` or to what happens before: an event (at `target` itself where `is_event`), or
   an indicator that has changed its sign within the last step, which Python then looks into. */
EXPORT int run_dop853(Loop *loop, Integrator *in, double *time, double target, int is_event) {
    int full = 0;
    in->rejected = 0;
    in->drive->passes = in->drive->calls = 0;
    for (;;) {
        int code = DONE;
        if (!in->reached) {
            if (*time >= target) return DONE;
            if (full) return FULL;
            const long rejected = in->rejected;
            code = advance(in, time, target);
            loop->rejected += in->rejected - rejected;
            if (code) return code;
            in->reached = 1;
            if (crossed(in, &code)) return CROSSED;
            if (code) return code;
        }
        code = reach(loop, in, *time, is_event && *time >= target, &full);
        if (code) return code;
    }
}
