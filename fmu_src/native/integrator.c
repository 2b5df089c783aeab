/* Dormand-Prince 5(4) with step-size control, never across a jump of the profiles.

   J. R. Dormand and P. J. Prince, J. Comput. Appl. Math. 6 (1980) 19-26; E. Hairer, S. P. Norsett
   and G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., section II.4. The twin of
   fmu_src/python/integrator.py and of the step in congelation/export/equations.py: every sum is
   in the same order. */

#include <math.h>
#include <string.h>

#include "block.h"

/* Hairer, Norsett, Wanner (4.13): a safety factor, and bounds on the change of the step. */
#define SAFETY 0.9
#define SMALLEST_CHANGE 0.2
#define LARGEST_CHANGE 5.0
/* An error so small asks for more than LARGEST_CHANGE, whatever it is: the power, which takes as long
   as a stage, need not be known. */
#define SMALL 1e-4
#define MOST_STEPS 100000
#define MOST_JUMPS 10000

enum { STAGES = 7 };
/* Nodes, coefficients (the last row is b, order 5), and e = b - b_hat of the error estimate. */
static const double C[] = {1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1, 1};
static const double A[6][6] = {
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84},
};
static const double E[] = {71.0 / 57600, 0, -71.0 / 16695, 71.0 / 1920, -17253.0 / 339200,
                           22.0 / 525, -1.0 / 40};

/* x + h sum_j a_j k_j for a stage, zero weights left out. Written out, as a loop over the weights
   takes as long as the rates of a small model. */
static void stage_point(int stage, const double *x, double h, const double *k, double *y)
{
    int n = STATES;
    const double *k1 = k, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *k5 = k4 + n, *k6 = k5 + n;
    const double *a = A[stage - 1];
    switch (stage) {
    case 1:
        for (int i = 0; i < n; i++) y[i] = x[i] + h * (a[0] * k1[i]);
        break;
    case 2:
        for (int i = 0; i < n; i++) y[i] = x[i] + h * (a[0] * k1[i] + a[1] * k2[i]);
        break;
    case 3:
        for (int i = 0; i < n; i++)
            y[i] = x[i] + h * (a[0] * k1[i] + a[1] * k2[i] + a[2] * k3[i]);
        break;
    case 4:
        for (int i = 0; i < n; i++)
            y[i] = x[i] + h * (a[0] * k1[i] + a[1] * k2[i] + a[2] * k3[i] + a[3] * k4[i]);
        break;
    case 5:
        for (int i = 0; i < n; i++)
            y[i] = x[i] + h * (a[0] * k1[i] + a[1] * k2[i] + a[2] * k3[i] + a[3] * k4[i]
                               + a[4] * k5[i]);
        break;
    default:
        for (int i = 0; i < n; i++)
            y[i] = x[i] + h * (a[0] * k1[i] + a[2] * k3[i] + a[3] * k4[i] + a[4] * k5[i]
                               + a[5] * k6[i]);
    }
}

/* h sum_j e_j k_j of component i. */
static double local_error(double h, const double *k, int i)
{
    int n = STATES;
    return h * (E[0] * k[i] + E[2] * k[2 * n + i] + E[3] * k[3 * n + i] + E[4] * k[4 * n + i]
                + E[5] * k[5 * n + i] + E[6] * k[6 * n + i]);
}

static void values_at(struct instance *in, double r)
{
    for (int i = 0; i < INPUTS; i++) {
        const double *c = in->cubics + 4 * i;
        in->v[i] = c[0] + r * (c[1] + r * (c[2] + r * c[3]));
    }
}

/* One step of length h from s, t being the time at s = 0: y, the rates there (the last stage), and
   the weighted error, at most 1 where the step meets the tolerance. */
static double step(struct instance *in, double t, double s, double h, double absolute,
                   double relative)
{
    double *k = in->k, worst = 0.0;
    for (int stage = 1; stage < STAGES; stage++) {
        double *target = stage == STAGES - 1 ? in->y : in->point;
        /* Stages 6 and 7 share their node. */
        if (stage < STAGES - 1) {
            double r = C[stage - 1] == 1.0 ? s + h : s + C[stage - 1] * h;
            values_at(in, r);
            theta_values(in, t + r);
        }
        stage_point(stage, in->x, h, k, target);
        model_rates(in->bound, target, in->v, in->theta, k + stage * STATES);
    }
    for (int i = 0; i < STATES; i++) {
        double error = fabs(local_error(h, k, i))
                       / (absolute + relative * greater(fabs(in->x[i]), fabs(in->y[i])));
        worst = i == 0 ? error : greater(worst, error);
    }
    return worst;
}

/* From s = start to s = end, on a smooth piece. */
static bool integrate(struct instance *in, double t, double start, double end, struct reason *why)
{
    double relative = in->state[TOLERANCE], absolute = 1e-3 * relative;
    double h = in->state[INNER_STEP], s = start;
    size_t size = (size_t)STATES * sizeof(double);
    values_at(in, start);
    theta_values(in, t + start);
    model_rates(in->bound, in->x, in->v, in->theta, in->k);
    for (int count = 0; count < MOST_STEPS; count++) {
        bool last = s + h >= end;
        double tried = last ? end - s : h;
        double error = step(in, t, s, tried, absolute, relative);
        /* greater() can drop a NaN, so the states are looked at too. */
        double total = 0.0;
        for (int i = 0; i < STATES; i++) total += in->y[i];
        if (error <= 1.0 && total - total == 0.0) {
            double change = error > SMALL ? SAFETY * pow(error, -1.0 / 5) : LARGEST_CHANGE;
            double proposed = tried * lesser(LARGEST_CHANGE, greater(SMALLEST_CHANGE, change));
            memcpy(in->x, in->y, size);
            if (last) {
                /* A step cut off by the end says nothing against the longer one tried before. */
                in->state[INNER_STEP] = tried < h ? greater(h, proposed) : proposed;
                return true;
            }
            memcpy(in->k, in->k + (STAGES - 1) * STATES, size);
            s += tried;
            h = proposed;
        } else {
            double change = 1.0 < error && error < INFINITY ? SAFETY * pow(error, -1.0 / 5)
                                                            : SMALLEST_CHANGE;
            h = tried * greater(SMALLEST_CHANGE, change);
            if (s + h <= s || h < 1e-13 * greater(fabs(t), 1e-3)) {
                explain(why,
                        "the states leave the range of floating-point numbers at t = %.9g; "
                        "the loop diverges: take a smaller communication step",
                        t + s);
                return false;
            }
        }
    }
    explain(why,
            "%d internal steps did not reach the end of the step from t = %.9g; "
            "take a smaller communication step",
            MOST_STEPS, t);
    return false;
}

bool advance(struct instance *in, double t, double h, struct reason *why)
{
    double start = 0.0, now = t;
    if (DELAYED) return delayed_step(in, t, h, why);
    if (STATES == 0) return true;
    input_cubics(in);
    if (PROFILES == 0) return integrate(in, t, 0.0, h, why);
    for (int jump = 0; jump < MOST_JUMPS; jump++) {
        if (!theta_at(in, now, why)) return false;
        double event = in->smooth.end;
        /* A jump at the very end of the step belongs to the next one. */
        if (event - t >= h) return integrate(in, t, start, h, why);
        if (!integrate(in, t, start, event - t, why)) return false;
        /* The time of the jump itself, not t + (event - t), which may round to before it. */
        start = event - t;
        now = event;
    }
    explain(why,
            "the profiles jump more than %d times in the step from t = %.9g; "
            "take a smaller communication step",
            MOST_JUMPS, t);
    return false;
}
