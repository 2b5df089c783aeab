/* From the values of the parameters to equations closed over them. */

#include <math.h>
#include <string.h>

#include "block.h"

/* A matrix counts as symmetric where its halves agree to this relative difference. */
#define SYMMETRY 1e-12

static bool is_definite(const struct parameter *p, const double *a, struct reason *why)
{
    int n = p->columns;
    double size = 0.0;
    for (int i = 0; i < n * n; i++) size = greater(size, fabs(a[i]));
    for (int i = 0; i < n; i++)
        for (int j = 0; j < i; j++)
            if (fabs(a[i * n + j] - a[j * n + i]) > SYMMETRY * size) {
                char one[32], other[32];
                explain(why,
                        "%s is refused: it must be symmetric, but %s[%d,%d] = %s and %s[%d,%d] = "
                        "%s",
                        p->name, p->name, i + 1, j + 1, repr_of(a[i * n + j], one), p->name, j + 1,
                        i + 1, repr_of(a[j * n + i], other));
                return false;
            }
    if (is_positive_definite(a, n)) return true;
    explain(why, "%s is refused: it must be positive definite", p->name);
    return false;
}

static bool is_valid(const struct parameter *p, const double *values, struct reason *why)
{
    if (p->domain == POSITIVE_DEFINITE) return is_definite(p, values, why);
    for (int i = 0; i < p->count; i++) {
        const char *phrase = NULL;
        double value = values[i];
        char text[32];
        if (p->domain == POSITIVE && !(value > 0.0)) phrase = "positive";
        if (p->domain == NONNEGATIVE && !(value >= 0.0)) phrase = "non-negative";
        if (p->domain == SIGN && fabs(value) != 1.0) phrase = "+1 or -1";
        if (phrase) {
            explain(why, "%s = %s is refused: it must be %s", VARIABLES[p->reference + i].name,
                    repr_of(value, text), phrase);
            return false;
        }
    }
    return true;
}

/* The constants begin with the parameters of the equations, in the order in which these take
   them. Where they are refused, the equations stay as they were. */
bool settle(struct instance *in)
{
    struct reason *why = &in->parameter_fault;
    for (int p = 0, at = 0; p < PARAMETERS; at += MODEL_PARAMETERS[p++].count)
        if (!is_valid(MODEL_PARAMETERS + p, in->constants + at, why)) return false;
    if (model_gains(in->constants, in->candidate_gains, why) != COMPUTED) return false;
    for (int i = 0; i < GAINS; i++)
        if (!isfinite(in->candidate_gains[i])) {
            explain(why, "the gains cannot be computed (a number becomes too large)");
            return false;
        }
    for (int j = 0; j < PROFILES; j++)
        if (!profile_bind(in->profiles + j, PROFILE_SLOTS + j, in->constants,
                          in->files + j * FILE_SIZE, why))
            return false;
    if (DELAYED && !ring_open(in, why)) return false;
    memcpy(in->gains, in->candidate_gains, (size_t)GAINS * sizeof(double));
    model_bind(in->constants, in->gains, in->bound);
    in->smooth.known = false;
    forget_computed(in);
    for (int i = 0; i < STATES; i++) in->x[i] = in->constants[START_CONSTANTS[i]];
    in->settled = true;
    return true;
}
