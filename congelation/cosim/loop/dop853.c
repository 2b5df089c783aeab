/* The explicit Runge-Kutta method of order 8 by Dormand and Prince, as `DOP853` of scipy.integrate, whose
   coefficients are given: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I,
   sections II.4 to II.6, and the Fortran program dop853.

   Whoever includes this defines `rates`: f = dx/dt at (t, x), not a number where it cannot be evaluated. */

enum { STAGES = 12, ALL_STAGES = 16, POWERS = 7 };

static int rates(Integrator *in, double t, const double *x, double *f);

static const double FACTOR = 0.9, SMALLEST_FACTOR = 0.2, LARGEST_FACTOR = 10.0;

/* x + h times the sum of K[j] a[j], j < count. */
static void combine(const Integrator *in, const double *x, const double *a, int count, double h,
                    double *result) {
    const ptrdiff_t n = in->n;
    for (ptrdiff_t i = 0; i < n; i++) result[i] = 0.0;
    for (int j = 0; j < count; j++) {
        if (a[j] == 0.0) continue;
        for (ptrdiff_t i = 0; i < n; i++) result[i] += in->K[j * n + i] * a[j];
    }
    for (ptrdiff_t i = 0; i < n; i++) result[i] = x[i] + h * result[i];
}

static double norm(const double *v, const double *scale, ptrdiff_t n) {
    double sum = 0.0;
    for (ptrdiff_t i = 0; i < n; i++) sum += (v[i] / scale[i]) * (v[i] / scale[i]);
    return sqrt(sum / (double)n);
}

/* The length of a first step from what f is at its start and after a short step of Euler's method. */
static int choose_first_step(Integrator *in, double time, double target) {
    const ptrdiff_t n = in->n;
    double *scale = in->work, *f = scale + n;
    const double left = target - time;
    if (!n) { in->step = left; return DONE; }
    for (ptrdiff_t i = 0; i < n; i++)
        scale[i] = in->tolerance * (in->nominal[i] + fabs(in->x[i]));
    const double d0 = norm(in->x, scale, n), d1 = norm(in->K, scale, n);
    double h0 = d0 < 1e-5 || d1 < 1e-5 ? 1e-6 : 0.01 * d0 / d1;
    if (!(h0 < left)) h0 = left;
    for (ptrdiff_t i = 0; i < n; i++) in->x_new[i] = in->x[i] + h0 * in->K[i];
    const int code = rates(in, time + h0, in->x_new, f);
    if (code) return code;
    for (ptrdiff_t i = 0; i < n; i++) f[i] -= in->K[i];
    const double d2 = norm(f, scale, n) / h0, largest = d1 > d2 ? d1 : d2;
    double h1 = h0 * 1e-3 > 1e-6 ? h0 * 1e-3 : 1e-6;
    if (!(d1 <= 1e-15 && d2 <= 1e-15)) h1 = pow(0.01 / largest, 1.0 / 8.0);
    in->step = 100.0 * h0 < h1 ? 100.0 * h0 : h1;
    if (!(in->step < left)) in->step = left;
    return DONE;
}

/* Error of the step from x to x_new, relative to the tolerance: of its norms of order 5 and 3. */
static double error_of(const Integrator *in, double h) {
    const ptrdiff_t n = in->n;
    double fifth = 0.0, third = 0.0;
    for (ptrdiff_t i = 0; i < n; i++) {
        const double a = fabs(in->x[i]), b = fabs(in->x_new[i]);
        const double scale = in->tolerance * (in->nominal[i] + (a > b ? a : b));
        double e5 = 0.0, e3 = 0.0;
        for (int j = 0; j <= STAGES; j++) {
            e5 += in->K[j * n + i] * in->E5[j];
            e3 += in->K[j * n + i] * in->E3[j];
        }
        fifth += (e5 / scale) * (e5 / scale);
        third += (e3 / scale) * (e3 / scale);
    }
    if (fifth == 0.0 && third == 0.0) return 0.0;
    return h * fifth / sqrt((fifth + 0.01 * third) * (double)n);
}

/* One step, of chosen length, towards `target`; afterwards x_old, t_old and K belong to it. */
static int advance(Integrator *in, double *time, double target) {
    const ptrdiff_t n = in->n;
    int code;
    if (in->restarts) {
        if ((code = rates(in, *time, in->x, in->K))) return code;
        if (in->step > 0.0) in->step = in->step < target - *time ? in->step : target - *time;
        else if ((code = choose_first_step(in, *time, target))) return code;
        in->restarts = 0;
    } else
        memcpy(in->K, in->K + STAGES * n, (size_t)n * sizeof(double));
    const double smallest = 10.0 * (nextafter(*time, INFINITY) - *time);
    double length = in->step > smallest ? in->step : smallest;
    for (int rejected = 0;; rejected = 1) {
        if (!(length >= smallest)) { in->step = length; return TOO_SMALL; }
        const double end = *time + length < target ? *time + length : target, h = end - *time;
        for (int s = 1; s < STAGES; s++) {
            combine(in, in->x, in->A + s * STAGES, s, h, in->x_new);
            if ((code = rates(in, *time + in->C[s] * h, in->x_new, in->K + s * n))) return code;
        }
        combine(in, in->x, in->B, STAGES, h, in->x_new);
        if ((code = rates(in, end, in->x_new, in->K + STAGES * n))) return code;
        const double error = error_of(in, h);
        if (error < 1.0) {
            double factor = LARGEST_FACTOR;
            if (error > 0.0) factor = fmin(factor, FACTOR * pow(error, -1.0 / 8.0));
            in->step = h * (rejected ? fmin(1.0, factor) : factor);
            if (error > in->largest) in->largest = error;
            in->t_old = *time;
            memcpy(in->x_old, in->x, (size_t)n * sizeof(double));
            memcpy(in->x, in->x_new, (size_t)n * sizeof(double));
            in->is_dense = 0;
            *time = end;
            return DONE;
        }
        length = h * fmax(SMALLEST_FACTOR, FACTOR * pow(error, -1.0 / 8.0));
        in->rejected++;
    }
}

/* The states at a time within the last step, which ended at `time`; of order 7. */
static int states_within(Integrator *in, double time, double at, double *result) {
    const ptrdiff_t n = in->n;
    const double h = time - in->t_old;
    double *F = in->F;
    if (!in->is_dense) {
        for (int s = STAGES + 1; s < ALL_STAGES; s++) {
            const int k = s - STAGES - 1;
            combine(in, in->x_old, in->A_extra + k * ALL_STAGES, s, h, in->x_new);
            const int code = rates(in, in->t_old + in->C_extra[k] * h, in->x_new, in->K + s * n);
            if (code) return code;
        }
        for (ptrdiff_t i = 0; i < n; i++) {
            const double f_old = in->K[i], f = in->K[STAGES * n + i], change = in->x[i] - in->x_old[i];
            F[i] = change;
            F[n + i] = h * f_old - change;
            F[2 * n + i] = 2.0 * change - h * (f + f_old);
            for (int d = 0; d < POWERS - 3; d++) {
                double sum = 0.0;
                for (int j = 0; j < ALL_STAGES; j++)
                    sum += in->D[d * ALL_STAGES + j] * in->K[j * n + i];
                F[(3 + d) * n + i] = h * sum;
            }
        }
        in->is_dense = 1;
    }
    const double s = (at - in->t_old) / h;
    for (ptrdiff_t i = 0; i < n; i++) {
        double sum = 0.0;
        for (int k = POWERS - 1; k >= 0; k--)
            sum = (sum + F[k * n + i]) * ((POWERS - 1 - k) % 2 ? 1.0 - s : s);
        result[i] = in->x_old[i] + sum;
    }
    return DONE;
}
