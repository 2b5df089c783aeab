/* The loop over time, as stepping.py and adaptive_step.py: steps chosen by a tolerance, or given. */

static const double SAFETY = 0.9, LARGEST_CHANGE = 4.0, SMALLEST_CHANGE = 0.2;  /* step_size.py */
static const double PROPORTIONAL = 0.4, INTEGRAL = 0.7, SMALLEST_ERROR = 1e-4;
static const double STRETCH = 1.1, SMALLEST_STEP = 16.0, SMALLEST_SHARE = 1e-15;  /* adaptive_step.py */
static const double JUMPED = 10.0, UNSEEN = 0.1, DELAYED = 10.0;  /* delayed_jumps.py, adaptive_step.py */
static const double SAMPLED_TOLERANCE = 1e-3, MOST_AMPLIFIED = 200.0;  /* recording.py */

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

/* StepSize.accepted */
static void lengthen(const Plan *plan, Memory *memory, double length, double scaled, int order) {
    const double error = scaled > SMALLEST_ERROR ? scaled : SMALLEST_ERROR;
    double change = SAFETY * pow(error, -INTEGRAL / order)
                  * pow(memory->error_before, PROPORTIONAL / order);
    const double largest = memory->rejected ? 1.0 : LARGEST_CHANGE;
    change = change > SMALLEST_CHANGE ? change : SMALLEST_CHANGE;
    change = change < largest ? change : largest;
    memory->step = length * change;
    if (scaled <= SMALLEST_ERROR && memory->step > plan->longest_at_rest) memory->step = plan->longest_at_rest;
    memory->error_before = error;
    memory->rejected = 0;
}

/* StepSize.refused */
static void shorten(Memory *memory, double length, double scaled, int order) {
    double change = SMALLEST_CHANGE;
    if (isfinite(scaled)) {
        change = SAFETY * pow(scaled, -1.0 / order);
        change = change > SMALLEST_CHANGE ? change : SMALLEST_CHANGE;
        change = change < SAFETY ? change : SAFETY;
    }
    memory->step = length * change;
    memory->rejected = 1;
}

/* One step from `time`, to *end: tried until its error is below the tolerance. On UNUSUAL it is for
   Python to make. */
static int fitting_step(Loop *loop, const Plan *plan, Memory *memory, State *states, double time,
                        double target, double *end) {
    const long before_saving = loop->calls;
    if (save(loop)) return REFUSED;
    const long saving = loop->calls - before_saving;
    memory->refused_length = 0.0;
    const int delays = !isinf(plan->longest_at_rest) && (plan->halves || plan->shortest_kept > 0.0)
                    && memory->state.n_times > 1;
    const double *times = memory->state.times + memory->state.n_times - 1;
    const double last = delays ? times[0] - times[-1] : 0.0;
    for (;;) {
        if (memory->rejected && delays && (plan->halves || last > DELAYED * memory->step)) {
            loop->calls -= saving;  /* which is done, and counted, once more */
            return UNUSUAL;
        }
        *end = end_of(time, memory->step, target);
        const double length = *end - time;
        Trial trial;
        const long calls = loop->calls, passes = loop->passes;
        const int code = plan->halves
            ? halved(loop, plan, memory, states, time, *end, &trial)
            : make(loop, plan, &memory->state, &states[0], time, *end, &trial);
        double scaled = trial.error / plan->tolerance;
        const int fits = code == DONE && scaled <= 1.0;
        if (fits) {
            /* A step may be good for the loop and too long for what is recorded in it. */
            const double recorded = unresolved(loop, memory, *end);
            if (recorded > scaled) scaled = recorded;
            memory->refused_length = 0.0;
        }
        const double size = fabs(time) > fabs(*end) ? fabs(time) : fabs(*end);
        const double rounding = SMALLEST_STEP * unit_in_the_last_place(size);
        const double share = SMALLEST_SHARE * plan->horizon;
        const int smallest = length <= (rounding > share ? rounding : share);
        int accepted = fits && scaled <= 1.0;
        /* A jump that the error does not show is for Python to locate. */
        const int jumps = fits && plan->halves && delays
            && ((scaled < UNSEEN && memory->jump > JUMPED * plan->tolerance)
                || memory->kink > JUMPED * plan->tolerance);
        const int kept = code == DONE && !accepted && length <= plan->shortest_kept;
        if (jumps) {
            accepted = 0;
        } else if (accepted) {
            lengthen(plan, memory, length, scaled, trial.order);
        } else if (code == DONE && !fits && !smallest && !kept && plan->halves) {
            accepted = memory->refused_length > 0.0 && is_floor(memory, length, plan->tolerance);
            if (accepted) {
                /* What is left comes from the FMUs, whose accuracy no step betters. */
                loop->floors++;
                memory->step = memory->refused_length;
                memory->rejected = 1;
            } else if (memory->refused_length == 0.0 || length <= MOST_OF_REFUSED * memory->refused_length) {
                memory->refused_length = length;
                memory->refused_error = memory->found;
            }
        }
        if (accepted) {
            const double stated = plan->halves ? memory->estimate : trial.error;
            if (stated > loop->largest_error) loop->largest_error = stated;
            if (plan->halves) accept_halves(loop, memory);
            take(loop, plan, &states[0], &memory->state);
            return DONE;
        }
        if (restore(loop)) return REFUSED;
        if (code != DONE || jumps || kept || (!fits && smallest)) {
            loop->calls = calls - saving;  /* which are made, and counted, once more */
            loop->passes = passes;
            return UNUSUAL;
        }
        shorten(memory, length, scaled, trial.order);
        loop->rejected++;
    }
}

/* Session.before */
static double left_of(double event, double horizon) {
    const double units = 8.0 * unit_in_the_last_place(event), gap = 1e-9 * horizon;
    return event - (gap > units ? gap : units);
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
        const double event = memory->event, before = left_of(event, plan->horizon);
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
        double end;
        loop->time = *time;
        const int code = fitting_step(loop, plan, memory, states, *time, target, &end);
        if (code) return code;
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
