/* Gains that follow from parameters by a Riccati equation: the twin of fmu_src/python/gains.py.

   The steps and their arithmetic are those explained and cited there, with `exact` numbers where
   it takes fractions. */

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "block.h"
#include "exact.h"

#define MOST_ITERATIONS 100
#define CONVERGED 1e-14
#define ROUGH 0x1p-20
#define FINE 0x1p-80
#define WIDTH 5e-10
#define ROUNDING 0x1p-52
#define LARGEST_FEASIBLE 1e12

/* -- memory: one block for a rule, handed out from its beginning ------------------------------- */

struct work {
    char *memory;
    size_t used, size;
};

/* Enough for order n with room to spare: the largest matrix is that of the Lyapunov equation. */
static bool open_work(struct work *work, int n)
{
    size_t pairs = (size_t)n * (size_t)(n + 1) / 2 + 2u * (size_t)n;
    work->used = 0;
    work->size = 65536 + 8 * pairs * pairs * sizeof(double)
                 + 64 * (size_t)n * (size_t)n * sizeof(exact);
    work->memory = malloc(work->size);
    return work->memory != NULL;
}

static void *take(struct work *work, size_t bytes)
{
    void *result = work->memory + work->used;
    work->used += (bytes + 15u) & ~(size_t)15u;
    if (work->used > work->size) abort(); /* open_work is wrong: never go on in foreign memory */
    return result;
}

static double *matrix(struct work *work, int rows, int columns)
{
    size_t bytes = (size_t)rows * (size_t)columns * sizeof(double);
    return memset(take(work, bytes), 0, bytes);
}

static exact *exact_matrix(struct work *work, int rows, int columns)
{
    size_t bytes = (size_t)rows * (size_t)columns * sizeof(exact);
    return memset(take(work, bytes), 0, bytes);
}

/* -- matrices of doubles, row by row ----------------------------------------------------------- */

/* The sum rounded once: J. R. Shewchuk, Discrete Comput. Geom. 18 (1997) 305-363, as in Python. */
double exact_sum(const double *terms, int count)
{
    double partial[64], high = 0.0, low = 0.0;
    int n = 0;
    for (int t = 0; t < count; t++) {
        double x = terms[t];
        int kept = 0;
        for (int i = 0; i < n; i++) {
            double y = partial[i];
            if (fabs(x) < fabs(y)) {
                double larger = y;
                y = x;
                x = larger;
            }
            high = x + y;
            low = y - (high - x);
            if (low != 0.0) partial[kept++] = low;
            x = high;
        }
        if (!isfinite(x) || kept >= 63) return x;
        n = kept;
        partial[n++] = x;
    }
    if (n == 0) return 0.0;
    high = partial[--n];
    low = 0.0;
    while (n > 0) {
        double x = high, y = partial[--n];
        high = x + y;
        low = y - (high - x);
        if (low != 0.0) break;
    }
    /* Half-way cases round to even over the whole sum. */
    if (n > 0 && ((low < 0.0 && partial[n - 1] < 0.0) || (low > 0.0 && partial[n - 1] > 0.0))) {
        double y = low * 2.0, x = high + y;
        if (y == x - high) high = x;
    }
    return high;
}

/* a (p x q) times b (q x r); terms is room for q. */
static void product(const double *a, const double *b, int p, int q, int r, double *result,
                    double *terms)
{
    for (int i = 0; i < p; i++)
        for (int j = 0; j < r; j++) {
            for (int k = 0; k < q; k++) terms[k] = a[i * q + k] * b[k * r + j];
            result[i * r + j] = exact_sum(terms, q);
        }
}

static double largest(const double *a, int count)
{
    double most = fabs(a[0]);
    for (int i = 1; i < count; i++) most = greater(most, fabs(a[i]));
    return most;
}

/* Gauss-Jordan elimination with partial pivoting: the inverse, and the determinant; false where
   a is singular. */
static bool invert(struct work *work, const double *a, int n, double *inverse, double *determinant)
{
    size_t mark = work->used;
    int width = 2 * n;
    double *rows = matrix(work, n, width), value = 1.0;
    for (int i = 0; i < n; i++) {
        memcpy(rows + i * width, a + i * n, (size_t)n * sizeof(double));
        rows[i * width + n + i] = 1.0;
    }
    *determinant = 0.0;
    for (int i = 0; i < n; i++) {
        int pivot = i;
        for (int r = i + 1; r < n; r++)
            if (fabs(rows[r * width + i]) > fabs(rows[pivot * width + i])) pivot = r;
        if (pivot != i) {
            for (int k = 0; k < width; k++) {
                double swapped = rows[i * width + k];
                rows[i * width + k] = rows[pivot * width + k];
                rows[pivot * width + k] = swapped;
            }
            value = -value;
        }
        double head = rows[i * width + i];
        if (head == 0.0) {
            work->used = mark;
            return false;
        }
        value *= head;
        for (int k = 0; k < width; k++) rows[i * width + k] /= head;
        for (int r = 0; r < n; r++) {
            double factor = rows[r * width + i];
            if (r == i || factor == 0.0) continue;
            for (int k = 0; k < width; k++)
                rows[r * width + k] = rows[r * width + k] - factor * rows[i * width + k];
        }
    }
    for (int i = 0; i < n; i++)
        memcpy(inverse + i * n, rows + i * width + n, (size_t)n * sizeof(double));
    *determinant = value;
    work->used = mark;
    return true;
}

bool is_positive_definite(const double *a, int n)
{
    bool definite = true;
    double *lower = calloc((size_t)(n * n + n), sizeof(double)), *terms = lower + n * n;
    if (!lower) return false;
    for (int i = 0; i < n && definite; i++)
        for (int j = 0; j <= i && definite; j++) {
            for (int k = 0; k < j; k++) terms[k] = lower[i * n + k] * lower[j * n + k];
            double rest = a[i * n + j] - exact_sum(terms, j);
            if (i != j) lower[i * n + j] = rest / lower[j * n + j];
            else if (rest > 0.0) lower[i * n + i] = sqrt(rest);
            else definite = false;
        }
    free(lower);
    return definite;
}

/* -- matrices of exact numbers ----------------------------------------------------------------- */

static void to_exact(const double *a, int count, exact *result)
{
    for (int i = 0; i < count; i++) result[i] = exact_of(a[i]);
}

static void to_doubles(const exact *a, int count, double *result)
{
    for (int i = 0; i < count; i++) result[i] = exact_rounded(a + i);
}

static void exact_product(const exact *a, const exact *b, int n, exact *result)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            exact total = exact_of(0.0);
            for (int k = 0; k < n; k++) {
                exact term = exact_multiply(a + i * n + k, b + k * n + j);
                total = exact_add(&total, &term);
            }
            result[i * n + j] = total;
        }
}

/* Whether a = a^T is positive definite: all pivots of the elimination are positive. */
static bool is_definite(struct work *work, const exact *a, int n)
{
    size_t mark = work->used;
    exact *rest = exact_matrix(work, n, n);
    bool definite = true;
    memcpy(rest, a, (size_t)(n * n) * sizeof(exact));
    for (int i = 0; i < n && definite; i++) {
        definite = rest[i * n + i].sign > 0;
        for (int r = i + 1; r < n && definite; r++) {
            exact factor = exact_divide(rest + r * n + i, rest + i * n + i);
            for (int k = i + 1; k < n; k++) {
                exact taken = exact_multiply(&factor, rest + i * n + k);
                rest[r * n + k] = exact_subtract(rest + r * n + k, &taken);
            }
        }
    }
    work->used = mark;
    return definite;
}

/* The inverse of a = a^T; false where a is not positive definite. */
static bool definite_inverse(struct work *work, const exact *a, int n, exact *inverse)
{
    size_t mark = work->used;
    int width = 2 * n;
    exact *rows = exact_matrix(work, n, width);
    for (int i = 0; i < n; i++) {
        memcpy(rows + i * width, a + i * n, (size_t)n * sizeof(exact));
        rows[i * width + n + i] = exact_of(1.0);
    }
    bool definite = true;
    for (int i = 0; i < n && definite; i++) {
        exact head = rows[i * width + i];
        definite = head.sign > 0;
        if (!definite) break;
        for (int k = 0; k < width; k++)
            rows[i * width + k] = exact_divide(rows + i * width + k, &head);
        for (int r = 0; r < n; r++) {
            exact factor = rows[r * width + i];
            if (r == i) continue;
            for (int k = 0; k < width; k++) {
                exact taken = exact_multiply(&factor, rows + i * width + k);
                rows[r * width + k] = exact_subtract(rows + r * width + k, &taken);
            }
        }
    }
    for (int i = 0; i < n && definite; i++)
        memcpy(inverse + i * n, rows + i * width + n, (size_t)n * sizeof(exact));
    work->used = mark;
    return definite;
}

/* -- the Riccati equation a^T P + P a - P g P + c = 0 ------------------------------------------- */

/* lim a_(k+1) = (a_k / c + c a_k^-1) / 2, in place; false where it does not converge. */
static bool matrix_sign(struct work *work, double *a, int n)
{
    size_t mark = work->used;
    int count = n * n;
    double *b = matrix(work, n, n), *differences = matrix(work, n, n), *sizes = matrix(work, n, n);
    double change = INFINITY, magnitude = 0.0;
    bool converged = false;
    for (int k = 0; k < MOST_ITERATIONS && !converged; k++) {
        double determinant;
        bool regular = invert(work, a, n, b, &determinant);
        double scale = regular ? pow(fabs(determinant), 1.0 / n) : 0.0;
        if (!(0.0 < scale && scale < INFINITY)) {
            work->used = mark;
            return false;
        }
        for (int i = 0; i < count; i++) {
            double new = 0.5 * (a[i] / scale + b[i] * scale);
            differences[i] = fabs(new - a[i]);
            sizes[i] = fabs(new);
            a[i] = new;
        }
        change = exact_sum(differences, count);
        magnitude = exact_sum(sizes, count);
        converged = change <= CONVERGED * magnitude;
    }
    work->used = mark;
    return converged || change <= 1e-9 * magnitude;
}

/* Whether all eigenvalues of a are in the open left half-plane. */
static bool is_hurwitz(struct work *work, const double *a, int n)
{
    size_t mark = work->used;
    double *sign = matrix(work, n, n);
    memcpy(sign, a, (size_t)(n * n) * sizeof(double));
    bool hurwitz = matrix_sign(work, sign, n);
    for (int i = 0; i < n && hurwitz; i++)
        for (int j = 0; j < n; j++)
            if (!(fabs(sign[i * n + j] + (i == j ? 1.0 : 0.0)) <= 1e-6)) hurwitz = false;
    work->used = mark;
    return hurwitz;
}

/* Where element (i, j) of a symmetric matrix stands among those of its upper triangle. */
static int place(int n, int i, int j)
{
    int low = i < j ? i : j, high = i < j ? j : i;
    return low * n - low * (low - 1) / 2 + high - low;
}

/* d = d^T with a^T d + d a + q = 0; false where a is too near to the edge of Hurwitz. */
static bool lyapunov(struct work *work, const double *a, const double *q, int n, double *d)
{
    size_t mark = work->used;
    int pairs = n * (n + 1) / 2;
    double *equations = matrix(work, pairs, pairs), *inverse = matrix(work, pairs, pairs);
    double *right = matrix(work, pairs, 1), *solved = matrix(work, pairs, 1);
    double *terms = matrix(work, pairs, 1), determinant;
    for (int i = 0; i < n; i++)
        for (int j = i; j < n; j++) {
            double *row = equations + place(n, i, j) * pairs;
            for (int k = 0; k < n; k++) {
                row[place(n, k, j)] += a[k * n + i];
                row[place(n, i, k)] += a[k * n + j];
            }
            right[place(n, i, j)] = -0.5 * (q[i * n + j] + q[j * n + i]);
        }
    bool regular = invert(work, equations, pairs, inverse, &determinant);
    if (regular) {
        product(inverse, right, pairs, pairs, 1, solved, terms);
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) d[i * n + j] = solved[place(n, i, j)];
    }
    work->used = mark;
    return regular;
}

/* Newton's method in doubles, in place, from a p with a - g p Hurwitz. */
static bool newton_rough(struct work *work, double *p, const double *a, const double *g,
                         const double *c, int n)
{
    size_t mark = work->used;
    double *taken = matrix(work, n, n), *closed = matrix(work, n, n), *half = matrix(work, n, n);
    double *lost = matrix(work, n, n), *residual = matrix(work, n, n), *step = matrix(work, n, n);
    double *terms = matrix(work, n, 1);
    bool done = false;
    for (int k = 0; k < MOST_ITERATIONS && !done; k++) {
        product(g, p, n, n, n, taken, terms);
        for (int i = 0; i < n * n; i++) closed[i] = a[i] - taken[i];
        if (!is_hurwitz(work, closed, n)) break;
        product(p, a, n, n, n, half, terms);
        product(p, g, n, n, n, taken, terms);
        product(taken, p, n, n, n, lost, terms);
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++)
                residual[i * n + j] = half[i * n + j] + half[j * n + i] - lost[i * n + j]
                                      + c[i * n + j];
        if (!lyapunov(work, closed, residual, n, step)) break;
        for (int i = 0; i < n * n; i++) p[i] = p[i] + step[i];
        done = largest(step, n * n) <= ROUGH * largest(p, n * n);
    }
    work->used = mark;
    return done;
}

/* The same in exact numbers; the steps are computed in doubles, from the exact residual. */
static bool newton_fine(struct work *work, exact *p, const double *a, const double *g,
                        const exact *c, int n)
{
    size_t mark = work->used;
    int count = n * n;
    exact *drift = exact_matrix(work, n, n), *quadratic = exact_matrix(work, n, n);
    exact *half = exact_matrix(work, n, n), *pg = exact_matrix(work, n, n);
    exact *lost = exact_matrix(work, n, n);
    double *rounded = matrix(work, n, n), *taken = matrix(work, n, n);
    double *closed = matrix(work, n, n), *residual = matrix(work, n, n);
    double *step = matrix(work, n, n), *terms = matrix(work, n, 1);
    bool done = false;
    to_exact(a, count, drift);
    to_exact(g, count, quadratic);
    for (int k = 0; k < MOST_ITERATIONS && !done; k++) {
        to_doubles(p, count, rounded);
        product(g, rounded, n, n, n, taken, terms);
        for (int i = 0; i < count; i++) closed[i] = a[i] - taken[i];
        if (!is_hurwitz(work, closed, n)) break;
        exact_product(p, drift, n, half);
        exact_product(p, quadratic, n, pg);
        exact_product(pg, p, n, lost);
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) {
                exact value = exact_add(half + i * n + j, half + j * n + i);
                value = exact_subtract(&value, lost + i * n + j);
                value = exact_add(&value, c + i * n + j);
                residual[i * n + j] = exact_rounded(&value);
            }
        if (!lyapunov(work, closed, residual, n, step)) break;
        for (int i = 0; i < count; i++) {
            exact correction = exact_of(step[i]);
            p[i] = exact_add(p + i, &correction);
        }
        to_doubles(p, count, rounded);
        done = largest(step, count) <= FINE * largest(rounded, count);
    }
    work->used = mark;
    return done;
}

/* P with a - g P Hurwitz; false where there is none. */
static bool riccati(struct work *work, const double *a, const double *g, const double *c, int n,
                    exact *p)
{
    size_t mark = work->used;
    int m = 2 * n;
    double *sign = matrix(work, m, m), *left = matrix(work, m, n), *right = matrix(work, m, n);
    double *transposed = matrix(work, n, m), *normal = matrix(work, n, n);
    double *inverse = matrix(work, n, n), *projected = matrix(work, n, n);
    double *x = matrix(work, n, n), *start = matrix(work, n, n), *terms = matrix(work, m, 1);
    double determinant;
    exact *exact_c = exact_matrix(work, n, n);
    bool found = false;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            sign[i * m + j] = a[i * n + j];
            sign[i * m + n + j] = -g[i * n + j];
            sign[(n + i) * m + j] = -c[i * n + j];
            sign[(n + i) * m + n + j] = -a[j * n + i];
        }
    if (matrix_sign(work, sign, m)) {
        /* X from the kernel of sign + I, which is spanned by [I; X]: least squares. */
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) {
                double one = i == j ? 1.0 : 0.0;
                left[i * n + j] = sign[i * m + n + j];
                left[(n + i) * n + j] = sign[(n + i) * m + n + j] + one;
                right[i * n + j] = sign[i * m + j] + one;
                right[(n + i) * n + j] = sign[(n + i) * m + j];
            }
        for (int i = 0; i < m; i++)
            for (int j = 0; j < n; j++) transposed[j * m + i] = left[i * n + j];
        product(transposed, left, n, m, n, normal, terms);
        if (invert(work, normal, n, inverse, &determinant)) {
            product(transposed, right, n, m, n, projected, terms);
            product(inverse, projected, n, n, n, x, terms);
            for (int i = 0; i < n; i++)
                for (int j = 0; j < n; j++)
                    start[i * n + j] = -0.5 * (x[i * n + j] + x[j * n + i]);
            if (newton_rough(work, start, a, g, c, n)) {
                to_exact(start, n * n, p);
                to_exact(c, n * n, exact_c);
                found = newton_fine(work, p, a, g, exact_c, n);
            }
        }
    }
    work->used = mark;
    return found;
}

/* -- the ISS K-filter, (43) --------------------------------------------------------------------- */

struct filter {
    int n;
    double *drift, *weight; /* -S and Q = I / epsilon^2 */
    exact *start;           /* P for r = infinity */
};

static bool open_filter(struct work *work, struct filter *filter, double epsilon, int n)
{
    double *observed = matrix(work, n, n);
    filter->n = n;
    filter->drift = matrix(work, n, n);
    filter->weight = matrix(work, n, n);
    filter->start = exact_matrix(work, n, n);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            filter->drift[i * n + j] = -1.0 * (j == i + 1 ? 1.0 : 0.0);
            filter->weight[i * n + j] = 1.0 / (epsilon * epsilon) * (i == j ? 1.0 : 0.0);
        }
    observed[0] = 1.0;
    return riccati(work, filter->drift, filter->weight, observed, n, filter->start);
}

/* P = X^-1 of (43) in p, rough or fine; false if there is none. */
static bool inverse_solution(struct work *work, const struct filter *filter, double r, bool fine,
                             exact *p)
{
    int n = filter->n;
    if (r <= 1.0) return false;
    size_t mark = work->used;
    exact *c = exact_matrix(work, n, n), one = exact_of(1.0), given = exact_of(r);
    exact square = exact_multiply(&given, &given), lost = exact_divide(&one, &square);
    double *rough = matrix(work, n, n), *c_rounded = matrix(work, n, n);
    for (int i = 0; i < n; i++) {
        exact diagonal = exact_of(i == 0 ? 1.0 : 0.0);
        c[i * n + i] = exact_subtract(&diagonal, &lost);
    }
    to_doubles(c, n * n, c_rounded);
    to_doubles(filter->start, n * n, rough);
    bool found = newton_rough(work, rough, filter->drift, filter->weight, c_rounded, n);
    to_exact(rough, n * n, p);
    if (found && fine) found = newton_fine(work, p, filter->drift, filter->weight, c, n);
    work->used = mark;
    return found;
}

/* X = P^-1 in doubles; false where rounding may take its definiteness. */
static bool solution(struct work *work, const exact *p, int n, double *x)
{
    size_t mark = work->used;
    exact *inverse = exact_matrix(work, n, n);
    bool definite = definite_inverse(work, p, n, inverse);
    if (definite) {
        to_doubles(inverse, n * n, x);
        exact margin = exact_of(n * ROUNDING * largest(x, n * n));
        to_exact(x, n * n, inverse);
        for (int i = 0; i < n; i++)
            inverse[i * n + i] = exact_subtract(inverse + i * n + i, &margin);
        definite = isfinite(largest(x, n * n)) && is_definite(work, inverse, n);
    }
    work->used = mark;
    return definite;
}

/* What a bisection asks: whether a number is feasible. */
struct question {
    struct work *work;
    const struct filter *filter;
    bool fine;
    const double *a; /* of filter_norm */
    int n;
};

typedef bool feasible(const struct question *question, double value);

static bool is_feasible_r(const struct question *q, double r)
{
    size_t mark = q->work->used;
    exact *p = exact_matrix(q->work, q->filter->n, q->filter->n);
    bool found = inverse_solution(q->work, q->filter, r, q->fine, p)
                 && is_definite(q->work, p, q->filter->n);
    q->work->used = mark;
    return found;
}

/* The least number that is feasible, to a relative width; infinite beyond LARGEST_FEASIBLE. */
static double least(feasible *is_feasible, const struct question *question, double infeasible,
                    double width)
{
    double low = infeasible, high = 2.0 * infeasible;
    while (!is_feasible(question, high)) {
        low = high;
        high = 2.0 * high;
        if (high > LARGEST_FEASIBLE) return INFINITY;
    }
    while (high - low > width * low) {
        double middle = 0.5 * (low + high);
        if (is_feasible(question, middle)) high = middle;
        else low = middle;
    }
    return high;
}

static double smallest_feasible_r(struct work *work, const struct filter *filter)
{
    struct question rough = {work, filter, false, NULL, 0}, fine = {work, filter, true, NULL, 0};
    size_t mark = work->used;
    exact *p = exact_matrix(work, filter->n, filter->n);
    double *x = matrix(work, filter->n, filter->n), margin = WIDTH;
    double edge = least(is_feasible_r, &rough, 1.0, WIDTH / 8);
    if (!isfinite(edge)) {
        work->used = mark;
        return INFINITY;
    }
    double low = edge * (1 - WIDTH / 2), r = edge * (1 + WIDTH / 4), first;
    if (is_feasible_r(&fine, low) || !is_feasible_r(&fine, r))
        r = least(is_feasible_r, &fine, 1.0, WIDTH);
    first = r;
    while (r <= LARGEST_FEASIBLE) {
        if (inverse_solution(work, filter, r, true, p) && solution(work, p, filter->n, x)) break;
        r = first * (1 + margin);
        margin = 2 * margin;
    }
    work->used = mark;
    return r <= LARGEST_FEASIBLE ? r : INFINITY;
}

static enum outcome no_memory(struct reason *why)
{
    explain(why, "there is no memory left");
    return UNCOMPUTABLE;
}

static enum outcome out_of_reach(struct reason *why)
{
    explain(why, "up to %.0e nothing solves the Riccati equation in double precision",
            LARGEST_FEASIBLE);
    return UNCOMPUTABLE;
}

/* The value with six digits, rounded up. */
static const char *rounded_up(double value, char text[32])
{
    double step = pow(10.0, floor(log10(value)) + 1 - 6);
    snprintf(text, 32, "%.6g", ceil(value / step) * step);
    return text;
}

/* k = X e_1 / 2 of the ISS K-filter (Theorem 1); arguments r, epsilon. */
enum outcome rule_iss_filter_gain(int n, int m, const double *const *arguments,
                                  const double *const *fixed, double *gains, struct reason *why)
{
    double r = arguments[0][0], epsilon = arguments[1][0];
    enum outcome outcome = COMPUTED;
    struct work work;
    struct filter filter;
    char text[32];
    (void)m, (void)fixed;
    if (!open_work(&work, n)) return no_memory(why);
    exact *p = exact_matrix(&work, n, n);
    double *x = matrix(&work, n, n);
    if (!open_filter(&work, &filter, epsilon, n)) {
        explain(why, "the Riccati equation (43) cannot be solved in double precision");
        outcome = UNCOMPUTABLE;
    } else if (!inverse_solution(&work, &filter, r, true, p) || !is_definite(&work, p, n)) {
        double smallest = smallest_feasible_r(&work, &filter);
        outcome = isfinite(smallest) ? INFEASIBLE : out_of_reach(why);
        if (outcome == INFEASIBLE)
            explain(why,
                    "(r = %.6g, epsilon = %.6g) is infeasible: (43) has no positive definite "
                    "solution; the smallest feasible r is %s",
                    r, epsilon, rounded_up(smallest, text));
    } else if (!solution(&work, p, n, x)) {
        explain(why, "the solution of (43) is too near to a singular matrix");
        outcome = UNCOMPUTABLE;
    } else {
        for (int i = 0; i < n; i++) gains[i] = 0.5 * x[i * n];
    }
    free(work.memory);
    return outcome;
}

/* -- filters with given gains ------------------------------------------------------------------- */

/* A_f = S - k e_1^T */
static void filter_matrix(const double *k, int n, double *a)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) a[i * n + j] = j == i + 1 ? 1.0 : 0.0;
    for (int i = 0; i < n; i++) a[i * n] -= k[i];
}

static enum outcome not_hurwitz(struct reason *why)
{
    explain(why, "A_f = S - k e_1^T is not Hurwitz; valid: the coefficients of a Hurwitz "
                 "polynomial s^n + k_1 s^(n-1) + .. + k_n");
    return INFEASIBLE;
}

/* k itself, if A_f is Hurwitz; argument k. */
enum outcome rule_hurwitz_filter_gain(int n, int m, const double *const *arguments,
                                      const double *const *fixed, double *gains,
                                      struct reason *why)
{
    struct work work;
    (void)m, (void)fixed;
    if (!open_work(&work, n)) return no_memory(why);
    double *a = matrix(&work, n, n);
    filter_matrix(arguments[0], n, a);
    bool hurwitz = is_hurwitz(&work, a, n);
    free(work.memory);
    memcpy(gains, arguments[0], (size_t)n * sizeof(double));
    return hurwitz ? COMPUTED : not_hurwitz(why);
}

/* Whether A_f^T P + P A_f + P^2 / g^2 + I = 0 has a solution P > 0: -P is a stabilising solution in
   the form with a definite quadratic term, and Newton's method may start at 0. */
static bool is_feasible_norm(const struct question *q, double gain)
{
    struct work *work = q->work;
    size_t mark = work->used;
    int n = q->n;
    double *g = matrix(work, n, n), *c = matrix(work, n, n), *p = matrix(work, n, n);
    exact *fine = exact_matrix(work, n, n), *exact_c = exact_matrix(work, n, n);
    for (int i = 0; i < n; i++) {
        g[i * n + i] = (1.0 / gain) * (1.0 / gain);
        c[i * n + i] = -1.0;
    }
    bool found = newton_rough(work, p, q->a, g, c, n);
    if (found) {
        to_exact(p, n * n, fine);
        to_exact(c, n * n, exact_c);
        found = newton_fine(work, fine, q->a, g, exact_c, n);
        for (int i = 0; i < n * n; i++) fine[i].sign = -fine[i].sign;
        found = found && is_definite(work, fine, n);
    }
    work->used = mark;
    return found;
}

/* The H-infinity norm of (40) with the gains k; argument k. */
enum outcome rule_filter_norm(int n, int m, const double *const *arguments,
                              const double *const *fixed, double *gains, struct reason *why)
{
    struct work work;
    (void)m, (void)fixed;
    if (!open_work(&work, n)) return no_memory(why);
    double *a = matrix(&work, n, n), *inverse = matrix(&work, n, n), determinant;
    enum outcome outcome = COMPUTED;
    filter_matrix(arguments[0], n, a);
    if (!is_hurwitz(&work, a, n)) {
        outcome = not_hurwitz(why);
    } else if (!invert(&work, a, n, inverse, &determinant)) {
        explain(why, "a division by zero");
        outcome = UNCOMPUTABLE;
    } else {
        struct question question = {&work, NULL, true, a, n};
        *gains = least(is_feasible_norm, &question, 0.5 * largest(inverse, n * n), WIDTH);
        if (!isfinite(*gains)) outcome = out_of_reach(why);
    }
    free(work.memory);
    return outcome;
}

/* -- the matched case --------------------------------------------------------------------------- */

/* P, row by row; arguments rho, epsilon, delta, damping, Q; fixed A, B (n x m). */
enum outcome rule_matched_riccati(int n, int m, const double *const *arguments,
                                  const double *const *fixed, double *gains, struct reason *why)
{
    double rho = arguments[0][0], epsilon = arguments[1][0], delta = arguments[2][0];
    bool damping = arguments[3][0] != 0.0;
    const double *Q = arguments[4], *B = fixed[1];
    double lost = damping ? (1.0 / epsilon) * (1.0 / epsilon) : 0.0;
    double margin = damping ? (epsilon * delta) * (epsilon * delta) : 0.0;
    enum outcome outcome = COMPUTED;
    struct work work;
    if (!open_work(&work, n > m ? n : m)) return no_memory(why);
    double *transposed = matrix(&work, m, n), *g = matrix(&work, n, n), *q = matrix(&work, n, n);
    double *terms = matrix(&work, m, 1);
    exact *p = exact_matrix(&work, n, n);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < m; j++) transposed[j * n + i] = B[i * m + j];
    product(B, transposed, n, m, n, g, terms);
    for (int i = 0; i < n * n; i++) g[i] = (rho - lost) * g[i];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            q[i * n + j] = Q[i * n + j] + margin * (i == j ? 1.0 : 0.0);
    if (riccati(&work, fixed[0], g, q, n, p) && is_definite(&work, p, n)) {
        to_doubles(p, n * n, gains);
    } else if (rho > lost || !isfinite(lost)) {
        explain(why, "the Riccati equation cannot be solved in double precision");
        outcome = UNCOMPUTABLE;
    } else {
        explain(why,
                "(rho = %.6g, epsilon = %.6g) is infeasible: the Riccati equation has no positive "
                "definite solution; take rho > 1/epsilon^2 = %.6g",
                rho, epsilon, lost);
        outcome = INFEASIBLE;
    }
    free(work.memory);
    return outcome;
}
