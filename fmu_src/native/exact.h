/* Numbers of about 550 bits, in place of the fractions of fmu_src/python/gains.py.

   The sums and products that Newton's method forms from doubles fit into them but for a relative
   2^-540, so that each rounds to the double to which the fraction rounds. */

#ifndef CONGELATION_EXACT_H
#define CONGELATION_EXACT_H

#include <stdbool.h>
#include <stdint.h>

#include "names.h"

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden) /* as in block.h */
#endif

enum { LIMBS = 18 };

/* sign sum_i limb_i 2^(32 (exponent - 1 - i)), the first limb not 0; sign 0: zero. */
struct exact {
    int sign, exponent;
    uint32_t limb[LIMBS];
};

typedef struct exact exact;

exact exact_of(double value);
double exact_rounded(const exact *a); /* to the nearest double, ties to even */
exact exact_add(const exact *a, const exact *b);
exact exact_subtract(const exact *a, const exact *b);
exact exact_multiply(const exact *a, const exact *b);
exact exact_divide(const exact *a, const exact *b);

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
