/* All states of a system integrated as one differential equation, by FMI 2.0 model exchange; as
   coupling/model_exchange.py and integration.py. */

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
static int reach(Loop *loop, Integrator *in, double time, int *is_event, int *full) {
    int code;
    for (; in->visited < in->n_visits && in->visits[in->visited] <= time + in->near; in->visited++) {
        const double at = in->visits[in->visited];
        if (at >= time - in->near) continue;  /* the end of the step is taken for it */
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
    *is_event |= asks;
    if (!ends && *is_event) return DONE;
    record(loop, time, POINT);
    *full = counted(loop, time);
    return ends ? TERMINATED : DONE;
}

/* Whether all that was read is as it was, up to what solutions of algebraic loops leave. */
static int settled(const Loop *loop, const Integrator *in) {
    for (ptrdiff_t k = 0; k < in->n_Y; k++) {
        const double before = in->Y_before[k], now = loop->Y[k];
        if (before != now && !(fabs(now - before) <= in->leaves * (1.0 + fabs(now)))) return 0;
    }
    return 1;
}

/* ModelExchangeStepper.start: through event mode, until no FMU has anything more to change. */
static int make_event(Loop *loop, Integrator *in, double time) {
    int again = 1, code;
    loop->calls += 3 * loop->n_slaves;
    for (int m = 0; m < loop->n_slaves; m++) {
        const Part *part = &in->parts[loop->which = m];
        *loop->slaves[m].note = part->event_note;
        const int status = part->enter_event(loop->slaves[m].component);
        if (status > WARNING) return refused(loop, status, "fmi2EnterEventMode");
    }
    for (int count = 0; again; count++) {
        if (count == MOST_ITERATIONS) return UNSETTLED;
        memcpy(in->Y_before, loop->Y, (size_t)in->n_Y * sizeof(double));
        again = 0;
        in->event = INFINITY;
        for (int m = 0; m < loop->n_slaves; m++) {
            DiscreteStates said = {0, 0, 0, 0, 0, 0.0};
            *loop->slaves[m].note = in->parts[loop->which = m].event_note;
            const int status = in->parts[m].new_states(loop->slaves[m].component, &said);
            if (status > WARNING) return refused(loop, status, "fmi2NewDiscreteStates");
            in->ended = m;
            if (said.ends) return TERMINATED;
            again |= said.again;
            if (!said.has_event) continue;
            if (said.event < in->event) in->event = said.event;
            if (said.event <= time) return LATE;
        }
        if ((code = run_exchange(loop))) return code;
        again |= !settled(loop, in);
    }
    for (int m = 0; m < loop->n_slaves; m++) {
        const Part *part = &in->parts[loop->which = m];
        void *component = loop->slaves[m].component;
        *loop->slaves[m].note = part->event_note;
        int status = part->enter_continuous(component);
        if (status > WARNING) return refused(loop, status, "fmi2EnterContinuousTimeMode");
        if (part->n_states) {
            double *nominal = in->nominal + part->first;
            status = part->get_states(component, in->x + part->first, part->n_states);
            if (status > WARNING) return refused(loop, status, "fmi2GetContinuousStates");
            status = part->get_nominals(component, nominal, part->n_states);
            if (status > WARNING) return refused(loop, status, "fmi2GetNominalsOfContinuousStates");
            for (size_t k = 0; k < part->n_states; k++)
                nominal[k] = nominal[k] == 0.0 ? 1.0 : fabs(nominal[k]);
        }
        if (part->n_indicators) {
            status = part->get_indicators(component, in->indicators, part->n_indicators);
            if (status > WARNING) return refused(loop, status, "fmi2GetEventIndicators");
            for (size_t k = 0; k < part->n_indicators; k++)
                part->positive[k] = in->indicators[k] > 0.0;
        }
    }
    return read_point(loop);
}

/* From *time to the stop time or to what happens before: an indicator that has changed its sign within
   the last step, which Python then looks into. */
EXPORT int run_dop853(Loop *loop, Integrator *in, double *time) {
    int full = 0;
    in->rejected = 0;
    in->drive->passes = in->drive->calls = 0;
    while (in->reached || *time < loop->stop) {
        const double target = in->event < loop->stop ? in->event : loop->stop;
        int code = DONE;
        if (full) return FULL;
        if (!in->reached) {
            code = advance(in, time, target);
            loop->rejected += in->rejected;
            in->rejected = 0;
            if (code) return code;
            in->reached = 1;
            if (crossed(in, &code)) return CROSSED;
            if (code) return code;
        }
        int is_event = in->event <= loop->stop && *time >= in->event;
        if ((code = reach(loop, in, *time, &is_event, &full))) return code;
        if (!is_event) continue;
        record(loop, *time, BEFORE_JUMP);
        in->in_event = 1;
        if ((code = make_event(loop, in, *time))) return code;
        in->in_event = 0;
        record(loop, *time, AFTER_JUMP);
        loop->events_crossed++;
        full = counted(loop, *time);
        in->restarts = 1;
        in->step = 0.0;
    }
    return DONE;
}
