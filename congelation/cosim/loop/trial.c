/* What trials of a step share: where they work, their error, how a slave is read. */

/* A trial of a step takes 14 L + 6 n + n^2 of it; then come the states of up to three trials, and what
   halving compares. */
enum { TRIALS = 3 };
static size_t trial_size(size_t L, size_t n) { return 14 * L + 6 * n + n * n; }
static size_t state_size(size_t L, size_t n) { return 2 * KEPT * L + n * n; }
EXPORT size_t work_size(size_t L, size_t n, size_t n_judged) {
    return trial_size(L, n) + TRIALS * state_size(L, n) + 3 * n_judged;
}

/* The largest of `distance` relative to nominal value plus size. */
static double relative(const Loop *loop, const double *distance, const double *values) {
    double largest = 0.0;
    for (ptrdiff_t k = 0; k < loop->n_links; k++) {
        const double error = distance[k] / (loop->nominal[k] + fabs(values[k]));
        if (!(error <= largest)) largest = error;
    }
    return largest;
}

/* What a trial of a step leaves besides the FMUs' states. */
typedef struct {
    double error;
    int order;
} Trial;

static double sum_of_products(const double *row, const double *data, int n, ptrdiff_t L) {
    double sum = 0.0;
    for (int j = 0; j < n; j++) sum += row[j] * data[j * L];
    return sum;
}

/* Send the inputs of a slave values alone, and read what it puts out for them. */
static int read_for_values(Loop *loop, const Slave *slave, const double *values) {
    const ptrdiff_t L = loop->n_links;
    for (ptrdiff_t k = loop->columns[loop->which]; k < loop->columns[loop->which + 1]; k++) {
        loop->C[k] = values[k];
        loop->C[L + k] = loop->C[2 * L + k] = loop->C[3 * L + k] = 0.0;
    }
    return call_writes(loop, slave, slave->writes, slave->n_writes);
}
