/* A step of `hermite`, as hermite.py and interpolant.py. */

enum { LOW = 4, HIGH = 6 };                        /* orders of a step */
static const double RESIDUE = 16.0 / 3150.0;       /* interpolant.py */
static const double UNEXPLAINED = 2.0;

/* Room of a trial: 2 L numbers each for ends that are extrapolated, by all points and by two, 6 L for
   the data of the polynomials, 2 L each for what is found and distances; then that of the iterations. */
typedef struct {
    double *predicted, *expected, *data, *new, *distance, *rest;
} Room;

static Room room_of(const Loop *loop, const Plan *plan) {
    const ptrdiff_t L = loop->n_links;
    double *w = plan->work;
    return (Room){w, w + 2 * L, w + 4 * L, w + 10 * L, w + 12 * L, w + 14 * L};
}

/* `_iterated` of hermite.py: all slaves once over the step. */
static int iterated(Loop *loop, const Plan *plan, const State *from, double time, double end,
                    const double *M, int width) {
    const ptrdiff_t L = loop->n_links;
    double *data = room_of(loop, plan).data, *new = room_of(loop, plan).new;
    const double h = end - time;
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
    return DONE;
}

/* How far the polynomial of a link is off where the link jumps within the step, from its values and
   derivatives at both ends; 0 where these explain its change. */
static double jumped(const double *before, const double *after, ptrdiff_t L, double h) {
    const double a = fabs(before[L]), b = fabs(after[L]), change = fabs(after[0] - before[0]);
    return change > UNEXPLAINED * (h * (a > b ? a : b)) ? change / 2.0 : 0.0;
}

/* `estimated_error` of interpolant.py, and the order of the next step. */
static void estimate(const Loop *loop, const Plan *plan, const State *from, State *to, double time,
                     double end, const int *back, int n_before, Trial *trial) {
    const ptrdiff_t L = loop->n_links;
    const Room room = room_of(loop, plan);
    double *predicted = room.predicted, *expected = room.expected, *distance = room.distance;
    const double *data = room.data, *new = room.new;
    const double h = end - time;
    const double g = n_before ? time - from->times[from->n_times - 1 - back[0]] : 0.0;
    if (!n_before) {
        for (ptrdiff_t k = 0; k < L; k++) {
            const double third = 2.0 * (data[k] - new[k]) + h * (data[L + k] + new[L + k]);
            distance[k] = fabs(third) * (4.0 / 27.0);
        }
        trial->error = relative(loop, distance, new);
        return;
    }
    if (n_before == 1) memcpy(expected, predicted, 2 * (size_t)L * sizeof *expected);
    else extrapolate(from, L, end, back, 1, expected);
    const double hg = h + g;
    for (ptrdiff_t k = 0; k < L; k++) {
        const double value = fabs(new[k] - expected[k]) * (h * h / (16.0 * (hg * hg)));
        const double slope = fabs(new[L + k] - expected[L + k]) * (h * h * h / (32.0 * hg * (h + h + g)));
        distance[k] = value > slope ? value : slope;
    }
    for (ptrdiff_t k = 0; plan->shortest_kept > 0.0 && k < L; k++) {
        const double jump = jumped(data + k, new + k, L, h);
        if (jump > distance[k]) distance[k] = jump;
    }
    const double low = relative(loop, distance, new);
    trial->error = low;
    if (plan->highest != HIGH || n_before < 2) return;
    const double kk = time - from->times[from->n_times - 1 - back[1]];
    const double top = h * (h / 2.0 + g), bottom = hg * (h + kk);
    const double share = top * top / (16.0 * (bottom * bottom));
    const double per_slope = 2.0 * (1.0 / h + 1.0 / hg + 1.0 / (h + kk));
    for (ptrdiff_t k = 0; k < L; k++) {
        const double value = fabs(new[k] - predicted[k]) * share;
        const double slope = fabs(new[L + k] - predicted[L + k]) * (share / per_slope);
        const double quintic = value > slope ? value : slope, residue = RESIDUE * distance[k];
        distance[L + k] = quintic > residue ? quintic : residue;
        const double jump = plan->shortest_kept > 0.0 ? jumped(data + k, new + k, L, h) : 0.0;
        if (jump > distance[L + k]) distance[L + k] = jump;
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
}

/* `attempt` of hermite.py: iterate until the ends that are fed back settle. `to` is the state at the end. */
static int attempt(Loop *loop, const Plan *plan, const State *from, State *to, double time, double end,
                   Trial *trial) {
    const ptrdiff_t L = loop->n_links, n = 2 * plan->n_back;
    const Room room = room_of(loop, plan);
    double *predicted = room.predicted, *data = room.data, *new = room.new;
    double *z = room.rest, *r = z + n, *z_before = r + n, *r_before = z_before + n;
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
        const int code = iterated(loop, plan, from, time, end, M, width);
        if (code) return code;
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

    estimate(loop, plan, from, to, time, end, back, n_before, trial);
    return DONE;
}
