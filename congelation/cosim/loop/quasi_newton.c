/* Quasi-Newton steps, as broyden.py. */

/* Broyden's update of J, (n, n): G moved by dz + dr while z moved by dz. */
static void learn(double *J, const double *dz, const double *dr, ptrdiff_t n, double *missed) {
    double square = 0.0;
    for (ptrdiff_t i = 0; i < n; i++) square += dz[i] * dz[i];
    if (square == 0.0) return;
    for (ptrdiff_t i = 0; i < n; i++) {
        double expected = 0.0;
        for (ptrdiff_t j = 0; j < n; j++) expected += J[i * n + j] * dz[j];
        missed[i] = dz[i] + dr[i] - expected;
    }
    for (ptrdiff_t i = 0; i < n; i++)
        for (ptrdiff_t j = 0; j < n; j++) J[i * n + j] += missed[i] * (dz[j] / square);
}

/* (I - J)^-1 r by elimination with pivots; r itself where that is singular. */
static void quasi_newton(const double *J, const double *r, ptrdiff_t n, double *A, double *x) {
    for (ptrdiff_t i = 0; i < n; i++) {
        x[i] = r[i];
        for (ptrdiff_t j = 0; j < n; j++) A[i * n + j] = (i == j ? 1.0 : 0.0) - J[i * n + j];
    }
    for (ptrdiff_t c = 0; c < n; c++) {
        ptrdiff_t pivot = c;
        for (ptrdiff_t i = c + 1; i < n; i++)
            if (fabs(A[i * n + c]) > fabs(A[pivot * n + c])) pivot = i;
        if (A[pivot * n + c] == 0.0) { memcpy(x, r, (size_t)n * sizeof *x); return; }
        if (pivot != c) {
            for (ptrdiff_t j = 0; j < n; j++) {
                const double kept = A[c * n + j];
                A[c * n + j] = A[pivot * n + j];
                A[pivot * n + j] = kept;
            }
            const double kept = x[c];
            x[c] = x[pivot];
            x[pivot] = kept;
        }
        for (ptrdiff_t i = c + 1; i < n; i++) {
            const double factor = A[i * n + c] / A[c * n + c];
            for (ptrdiff_t j = c; j < n; j++) A[i * n + j] -= factor * A[c * n + j];
            x[i] -= factor * x[c];
        }
    }
    for (ptrdiff_t i = n - 1; i >= 0; i--) {
        for (ptrdiff_t j = i + 1; j < n; j++) x[i] -= A[i * n + j] * x[j];
        x[i] /= A[i * n + i];
    }
}
