/* A step of `derivative`, as derivative.py. */

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
