/* Rows, steps that are counted, values that have to be finite; as session.py and recording.py. */

static int is_finite(const Loop *loop) {
    const double limit = 1e200;  /* the square of LARGEST_VALUE of ensemble.py */
    for (int m = 0; m < loop->n_slaves; m++) {
        const Slave *slave = &loop->slaves[m];
        double sum = 0.0;
        for (size_t i = 0; i < slave->n_checked; i++) sum += slave->checked[i] * slave->checked[i];
        if (!(sum < limit)) return 0;
    }
    return 1;
}

/* A communication point: as EveryStep of recording.py, or for Python to make rows of. */
static void record(Loop *loop, double time, int kind) {
    if (!loop->kinds && kind == BEFORE_JUMP) return;
    if (loop->left && kind == POINT) { loop->left--; return; }
    loop->left = loop->every - 1;
    if (loop->kinds) loop->kinds[loop->n_rows] = (unsigned char)kind;
    double *row = loop->rows + loop->n_rows++ * (1 + loop->width);
    row[0] = time;
    for (ptrdiff_t k = 0; k < loop->width; k++) row[1 + k] = loop->Y[loop->recorded[k]];
}

/* Whether there is room for what a step or a jump records. */
static int has_room(const Loop *loop) {
    return loop->capacity - loop->n_rows >= (loop->kinds ? 2 : 1);
}

/* Session._count: whether as many steps have been made as are to be. */
static int counted(Loop *loop, double time) {
    loop->counted_before = loop->counted;
    loop->counted = time;
    loop->steps++;
    return loop->steps + loop->rejected >= loop->most;
}

static double unit_in_the_last_place(double value) {
    const double size = fabs(value);
    return nextafter(size, INFINITY) - size;
}

static double just_before(double event) { return event - 8.0 * unit_in_the_last_place(event); }

/* Session.next_event */
static double next_event(const Loop *loop, double time) {
    double event = INFINITY;
    for (int k = 0; k < loop->n_events; k++) {
        const double announced = loop->Y[loop->events[k]];
        if (announced > time && announced < event) event = announced;
    }
    if (event > loop->stop) return INFINITY;
    return event < just_before(loop->stop) ? event : loop->stop;
}
