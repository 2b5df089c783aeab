/* Outputs and inputs made to agree, as exchange.py; jumps, where they are made to agree anew. */

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

/* Exchange.carry: outputs to inputs, in the order of the dependencies. */
static int carry(Loop *loop) {
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
    return DONE;
}

/* Exchange.run, of a system without discrete connections. */
EXPORT int run_exchange(Loop *loop) {
    const size_t L = (size_t)loop->n_links;
    memset(loop->C + 2 * L, 0, 2 * L * sizeof(double));
    const int carried = carry(loop);
    if (carried) return carried;
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
