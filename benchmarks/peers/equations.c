/* The equations of one native FMU, closed over its parameters; compiled once for each FMU, with its
   sources and a prefix of its own. */

#include <stdlib.h>
#include <string.h>

#include "block.h"

#define SHOWN __attribute__((visibility("default")))

static double *constants, *gains;
static void *bound;

/* All constants as the FMU starts them. */
SHOWN void OWN(restart)(void)
{
    constants = calloc((size_t)CONSTANTS + 1u, sizeof(double));
    gains = calloc((size_t)GAINS + 1u, sizeof(double));
    bound = calloc(1, BOUND_SIZE);
    for (int i = 0; i < VARIABLE_COUNT; i++)
        if (VARIABLES[i].role == CONSTANT) constants[VARIABLES[i].index] = VARIABLES[i].start;
}

SHOWN int OWN(assign)(const char *name, double value)
{
    for (int i = 0; i < VARIABLE_COUNT; i++)
        if (VARIABLES[i].role == CONSTANT && !strcmp(VARIABLES[i].name, name)) {
            constants[VARIABLES[i].index] = value;
            return 1;
        }
    return 0;
}

SHOWN int OWN(close)(void)
{
    struct reason why;
    if (model_gains(constants, gains, &why) != COMPUTED) return 0;
    model_bind(constants, gains, bound);
    return 1;
}

void OWN(rates)(const double *x, const double *v, const double *theta, double *result)
{
    model_rates(bound, x, v, theta, result);
}

void OWN(outputs)(const double *x, const double *v, double *result)
{
    model_outputs(bound, x, v, NULL, result);
}
