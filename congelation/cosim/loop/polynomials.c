/* Polynomials through points of the past, as polynomial.py and points.py. */

static const double LONGEST_EXTRAPOLATION = 20.0;  /* points.py */

/* `interpolation` of polynomial.py: weights of value and derivative at `at`, (2, 2 n). */
static void interpolate(const double *nodes, int n, double at, double *weights) {
    for (int i = 0; i < n; i++) {
        double lagrange = 1.0, slope = 0.0, own_slope = 0.0;
        for (int j = 0; j < n; j++) {
            if (j == i) continue;
            const double gap = nodes[i] - nodes[j], factor = (at - nodes[j]) / gap;
            slope = slope * factor + lagrange / gap;
            lagrange *= factor;
            own_slope += 1.0 / gap;
        }
        const double square = lagrange * lagrange, square_slope = 2.0 * lagrange * slope;
        const double tilt = 1.0 - 2.0 * own_slope * (at - nodes[i]);
        weights[i] = tilt * square;
        weights[2 * n + i] = tilt * square_slope - 2.0 * own_slope * square;
        weights[n + i] = (at - nodes[i]) * square;
        weights[3 * n + i] = (at - nodes[i]) * square_slope + square;
    }
}

/* `hermite` of polynomial.py, (4, 4) in rows of `width`. */
static void cubic(double h, double *M, int width) {
    const double a = 1.0 / h, b = 6.0 / (h * h), c = 2.0 * a * b;
    const double entries[4][4] = {{1.0, 0.0, 0.0, 0.0}, {0.0, 1.0, 0.0, 0.0},
                                  {-b, -4.0 * a, b, -2.0 * a}, {c, b, -c, b}};
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < width; j++) M[i * width + j] = j < 4 ? entries[i][j] : 0.0;
}

/* `matched` of polynomial.py, (4, 6). */
static void matched(double h, double g, double *M) {
    const double r = g / h, q = 1.0 + r;
    const double missed[2][6] = {
        {(2.0 * r - 1.0) * q * q, h * r * q * q, -r * r * (3.0 + 2.0 * r), h * r * r * q, 1.0, 0.0},
        {-6.0 * r * q, -h * q * (1.0 + 3.0 * r), 6.0 * r * q, -h * r * (2.0 + 3.0 * r), 0.0, h}};
    const double w = (r * q) * (r * q), slope = -2.0 * r * q * (1.0 + 2.0 * r);
    cubic(h, M, 6);
    for (int j = 0; j < 6; j++) {
        const double beta = (missed[1][j] - slope / w * missed[0][j]) / w;
        const double alpha = missed[0][j] / w + r * beta;
        const double A = -alpha / 15.0 - beta * (2.0 / 35.0);
        const double B = alpha * (2.0 / 3.0) + beta * (3.0 / 7.0);
        M[j] += A;
        M[6 + j] += (B - 2.0 * A) / h;
        M[12 + j] += 2.0 * (A - 2.0 * B) / (h * h);
        M[18 + j] += 6.0 * B / (h * h * h);
    }
}

/* `differentiation` of polynomial.py: weights of value and derivative at `at` of the polynomial through
   the nodes, (n,) each. */
static void differentiate(const double *nodes, int n, double at, double *value, double *slope) {
    double product = 1.0, distance = nodes[0] - at;
    memset(value, 0, (size_t)n * sizeof *value);
    memset(slope, 0, (size_t)n * sizeof *slope);
    value[0] = 1.0;
    for (int i = 1; i < n; i++) {
        const double previous = distance;
        double partial = 1.0;
        distance = nodes[i] - at;
        for (int j = 0; j < i; j++) {
            const double gap = nodes[i] - nodes[j];
            partial *= gap;
            if (j == i - 1) {
                slope[i] = product * (value[j] - previous * slope[j]) / partial;
                value[i] = -product * previous * value[j] / partial;
            }
            slope[j] = (distance * slope[j] - value[j]) / gap;
            value[j] = distance * value[j] / gap;
        }
        product = partial;
    }
}

/* Values and derivatives at `end` by the polynomials through the newest point and `n` before it. */
static void extrapolate(const State *state, ptrdiff_t L, double end, const int *back, int n,
                        double *found) {
    const double now = state->times[state->n_times - 1];
    double nodes[KEPT], weights[4 * KEPT];
    nodes[0] = 0.0;
    for (int i = 0; i < n; i++) nodes[1 + i] = state->times[state->n_times - 1 - back[i]] - now;
    interpolate(nodes, n + 1, end - now, weights);
    for (int row = 0; row < 2; row++)
        for (ptrdiff_t k = 0; k < L; k++) {
            double sum = 0.0;
            for (int kind = 0; kind < 2; kind++)
                for (int i = 0; i <= n; i++) {
                    const int place = KEPT - 1 - (i ? back[i - 1] : 0);
                    sum += weights[row * 2 * (n + 1) + kind * (n + 1) + i]
                         * state->table[(kind * KEPT + place) * L + k];
                }
            found[row * L + k] = sum;
        }
}

/* Points.predicted: value and derivative at `time` by the polynomial through a link's values. */
static void predict(const State *state, ptrdiff_t L, double time, ptrdiff_t k, double *value,
                    double *slope) {
    const int n = state->n_times;
    double nodes[KEPT] = {0.0}, of_value[KEPT], of_slope[KEPT];
    for (int i = 0; i < n; i++) nodes[i] = state->times[i] - time;
    differentiate(nodes, n, 0.0, of_value, of_slope);
    *value = *slope = 0.0;
    for (int i = 0; i < n; i++) {
        const double known = state->table[(KEPT - n + i) * L + k];
        *value += of_value[i] * known;
        *slope += of_slope[i] * known;
    }
}

/* LinkReader.end: the value of link k at the end of a step, and its derivative. Where the source says
   none, it comes from the values, and the one at the start is improved. */
static void read_end(const Loop *loop, const State *state, double end, ptrdiff_t k, double *at_start,
                     double *value, double *slope) {
    *value = loop->Y[loop->source[k]];
    if (loop->source_derivative[k] >= 0) {
        *slope = loop->Y[loop->source_derivative[k]];
        return;
    }
    const ptrdiff_t L = loop->n_links;
    const int n = state->n_times;
    double nodes[KEPT + 1], of_value[KEPT + 1], of_start[KEPT + 1], of_end[KEPT + 1];
    for (int i = 0; i < n; i++) nodes[i] = state->times[i] - end;
    nodes[n] = end - end;
    differentiate(nodes, n + 1, nodes[n - 1], of_value, of_start);
    differentiate(nodes, n + 1, 0.0, of_value, of_end);
    *at_start = *slope = 0.0;
    for (int i = 0; i <= n; i++) {
        const double known = i < n ? state->table[(KEPT - n + i) * L + k] : *value;
        *at_start += of_start[i] * known;
        *slope += of_end[i] * known;
    }
}

/* The state after a step to `end`; Points.followed. */
static void follow(const State *from, State *to, double end, const double *new, ptrdiff_t L) {
    const int drops = from->n_times == KEPT;
    to->n_times = from->n_times + !drops;
    memmove(to->times, from->times + drops, (size_t)(to->n_times - 1) * sizeof(double));
    to->times[to->n_times - 1] = end;
    for (int row = 0; row < 2; row++) {
        double *points = to->table + row * KEPT * L;
        memmove(points, from->table + (row * KEPT + 1) * L, (KEPT - 1) * (size_t)L * sizeof(double));
        memcpy(points + (KEPT - 1) * L, new + row * L, (size_t)L * sizeof(double));
    }
}
