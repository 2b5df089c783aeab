/* Steps with held inputs: Jacobi, Gauss-Seidel; as held.py. */

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
