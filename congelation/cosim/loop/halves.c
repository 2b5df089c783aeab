/* Steps made whole and in halves, as step_size.py. */

enum { PROBED = 8 };
static const double SHARES = 2.0, LEAST_SHARE = 1e-2, PASSING_SHARE = 0.3, FLOOR_EXPONENT = 0.25;
static const double MOST_OF_REFUSED = 0.5, MANY = 8.0, FEW = 1.4, FEWER = 2.5, MORE = 1.6;
static const double LEAST_SHARE_UNSEEN = 0.2, PASSING_SHARE_UNSEEN = 1.2;
static const double SHORTEST_JUDGED = 1e-6;

static double larger(double a, double b) { return a > b ? a : b; }

/* A step for a trial, whatever the coupling. */
static int make(Loop *loop, const Plan *plan, const State *from, State *to, double time, double end,
                Trial *trial) {
    const int code = plan->iterates ? attempt(loop, plan, from, to, time, end, trial)
                                    : extrapolated(loop, plan, from, to, time, end, trial);
    return code == DONE && !is_finite(loop) ? NOT_FINITE : code;
}

/* The last trial of two, and the judged values after the first, (n_judged,). */
static int in_halves(Loop *loop, const Plan *plan, const State *from, State *middle, State *to,
                     double time, double end, Trial *trial, double *values) {
    const double between = time + (end - time) / 2.0;
    int code = make(loop, plan, from, middle, time, between, trial);
    for (ptrdiff_t k = 0; k < loop->n_judged; k++) values[k] = loop->Y[loop->judged[k]];
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
    const ptrdiff_t L = loop->n_links, W = loop->n_judged, n = 2 * plan->n_back;
    double *at_end = plan->work + trial_size((size_t)L, (size_t)n)
                   + TRIALS * state_size((size_t)L, (size_t)n);
    double *at_middle = at_end + W, *first_half = at_middle + W;
    const State *from = &memory->state;
    int probes = 0;
    int code = make(loop, plan, from, &states[0], time, end, trial);
    for (ptrdiff_t k = 0; k < W; k++) at_end[k] = loop->Y[loop->judged[k]];
    if (code || !isfinite(trial->error)) return code;
    if (!memory->left) {
        if ((code = restore(loop))) return code;
        code = in_halves(loop, plan, from, &states[1], &states[0], time, time + (end - time) / 2.0,
                         trial, first_half);
        if (code) return code;
        probes = isfinite(trial->error);
        for (ptrdiff_t k = 0; k < W; k++) at_middle[k] = loop->Y[loop->judged[k]];
    }
    if ((code = restore(loop))) return code;
    code = in_halves(loop, plan, from, &states[1], &states[0], time, end, trial, first_half);
    if (code || !W || !isfinite(trial->error)) return code;
    const double even = SHARES * (end - time) / plan->horizon;
    const double *now = from->table + (KEPT - 1) * L, *slope = from->table + (2 * KEPT - 1) * L;
    memory->found = memory->estimate = memory->jump = memory->kink = trial->error = 0.0;
    trial->order = 1;
    const int is_short = end - time <= SHORTEST_JUDGED * plan->horizon;
    for (ptrdiff_t k = 0; k < W; k++) {
        const double found = loop->Y[loop->judged[k]], difference = found - at_end[k];
        if (probes) {
            /* a h + b h^3 over the step, a h/2 + b h^3/8 over its half */
            const double lasting = fabs(difference - 2.0 * (at_middle[k] - first_half[k])) * (4.0 / 3.0);
            memory->lasting[k] = fabs(difference) > lasting ? lasting / fabs(difference) : 1.0;
        }
        const double size = memory->sizes[k] > fabs(found) ? memory->sizes[k] : fabs(found);
        const double scale = loop->judged_nominal[k] + size;
        const double error = is_short && k >= L ? 0.0 : fabs(difference) / 3.0 / scale;
        if (k < L) {  /* jump_within */
            const double length = end - time;
            const double off = fabs(found - now[k] - length * slope[k]);
            const double half = fabs(first_half[k] - now[k] - (length / 2.0) * slope[k]);
            const int kinked = MORE * half < off && off < FEWER * half;
            if (off > MANY * half || off < FEW * half) memory->jump = larger(memory->jump, off / scale);
            if (kinked) memory->kink = larger(memory->kink, off / scale);
        }
        const double least = k < L ? LEAST_SHARE : LEAST_SHARE_UNSEEN;
        const double lasts = error * memory->lasting[k] / larger(even, least);
        const double passes = error / (k < L ? PASSING_SHARE : PASSING_SHARE_UNSEEN);
        memory->found = larger(memory->found, error);
        memory->estimate = larger(memory->estimate, larger(lasts, error / PASSING_SHARE));
        if (larger(lasts, passes) > trial->error) {
            trial->error = larger(lasts, passes);
            trial->order = passes >= lasts ? 1 : even < least ? 3 : 2;
        }
    }
    return DONE;
}

/* Whether a shorter step than the one refused has hardly less of an error, which the run can bear. */
static int is_floor(const Memory *memory, double length, double tolerance) {
    const double ratio = length / memory->refused_length;
    return memory->found <= PASSING_SHARE * tolerance && ratio <= MOST_OF_REFUSED
        && memory->found > memory->refused_error * pow(ratio, FLOOR_EXPONENT);
}

static void accept_halves(const Loop *loop, Memory *memory) {
    memory->left = memory->left ? memory->left - 1 : PROBED;
    for (ptrdiff_t k = 0; k < loop->n_judged; k++) {
        const double size = fabs(loop->Y[loop->judged[k]]);
        if (size > memory->sizes[k]) memory->sizes[k] = size;
    }
}
