/* See exact.h: schoolbook arithmetic; results are cut off behind the last limb. */

#include "exact.h"

#include <math.h>
#include <string.h>

static exact zero(void)
{
    exact result;
    memset(&result, 0, sizeof result);
    return result;
}

exact exact_of(double value)
{
    exact result = zero();
    int e, limbs;
    double mantissa;
    if (value == 0.0 || !isfinite(value)) return result;
    result.sign = value < 0.0 ? -1 : 1;
    mantissa = frexp(fabs(value), &e); /* in [1/2, 1) */
    /* Limbs before the point: the mantissa is shifted to a multiple of 32 bits. */
    limbs = e > 0 ? (e + 31) / 32 : -(-e / 32);
    mantissa = ldexp(mantissa, e - 32 * limbs);
    result.exponent = limbs;
    for (int i = 0; i < LIMBS && mantissa != 0.0; i++) {
        mantissa *= 4294967296.0;
        result.limb[i] = (uint32_t)mantissa;
        mantissa -= result.limb[i];
    }
    return result;
}

double exact_rounded(const exact *a)
{
    uint64_t high = 0, half = UINT64_C(1) << 10, rest;
    int shift = 0;
    bool sticky = false;
    if (a->sign == 0) return 0.0;
    while (!((a->limb[0] << shift) & UINT32_C(0x80000000))) shift++;
    /* The first 64 significant bits, and whether any follows. */
    high = ((uint64_t)a->limb[0] << 32 | a->limb[1]) << shift;
    if (shift) high |= a->limb[2] >> (32 - shift);
    sticky = shift ? (uint32_t)(a->limb[2] << shift) != 0 : a->limb[2] != 0;
    for (int i = 3; i < LIMBS; i++) sticky = sticky || a->limb[i] != 0;
    rest = high & ((half << 1) - 1);
    high >>= 11;
    if (rest > half || (rest == half && (sticky || (high & 1)))) high++;
    return a->sign * ldexp((double)high, 32 * a->exponent - shift - 53);
}

/* Order of the magnitudes. */
static int compare(const exact *a, const exact *b)
{
    if (a->exponent != b->exponent) return a->exponent < b->exponent ? -1 : 1;
    for (int i = 0; i < LIMBS; i++)
        if (a->limb[i] != b->limb[i]) return a->limb[i] < b->limb[i] ? -1 : 1;
    return 0;
}

/* Limb i of b where a's limbs stand, or 0. */
static uint32_t shifted(const exact *b, int offset, int i)
{
    int place = i - offset;
    return place >= 0 && place < LIMBS ? b->limb[place] : 0;
}

exact exact_add(const exact *a, const exact *b)
{
    exact result;
    if (a->sign == 0) return *b;
    if (b->sign == 0) return *a;
    if (compare(a, b) < 0) {
        const exact *larger = b;
        b = a;
        a = larger;
    }
    int offset = a->exponent - b->exponent;
    result = *a;
    if (a->sign == b->sign) {
        uint64_t carry = 0;
        for (int i = LIMBS - 1; i >= 0; i--) {
            carry += (uint64_t)a->limb[i] + shifted(b, offset, i);
            result.limb[i] = (uint32_t)carry;
            carry >>= 32;
        }
        if (carry) {
            memmove(result.limb + 1, result.limb, (LIMBS - 1) * sizeof(uint32_t));
            result.limb[0] = (uint32_t)carry;
            result.exponent++;
        }
        return result;
    }
    int64_t borrow = 0;
    for (int i = LIMBS - 1; i >= 0; i--) {
        int64_t difference = (int64_t)a->limb[i] - shifted(b, offset, i) + borrow;
        borrow = difference < 0 ? -1 : 0;
        result.limb[i] = (uint32_t)(difference + (difference < 0 ? INT64_C(4294967296) : 0));
    }
    int leading = 0;
    while (leading < LIMBS && result.limb[leading] == 0) leading++;
    if (leading == LIMBS) return zero();
    memmove(result.limb, result.limb + leading, (size_t)(LIMBS - leading) * sizeof(uint32_t));
    memset(result.limb + LIMBS - leading, 0, (size_t)leading * sizeof(uint32_t));
    result.exponent -= leading;
    return result;
}

exact exact_subtract(const exact *a, const exact *b)
{
    exact negative = *b;
    negative.sign = -negative.sign;
    return exact_add(a, &negative);
}

exact exact_multiply(const exact *a, const exact *b)
{
    exact result = zero();
    uint32_t product[2 * LIMBS] = {0};
    if (a->sign == 0 || b->sign == 0) return result;
    for (int i = LIMBS - 1; i >= 0; i--) {
        uint64_t carry = 0;
        for (int j = LIMBS - 1; j >= 0; j--) {
            carry += (uint64_t)a->limb[i] * b->limb[j] + product[i + j + 1];
            product[i + j + 1] = (uint32_t)carry;
            carry >>= 32;
        }
        product[i] = (uint32_t)carry;
    }
    int leading = product[0] == 0;
    memcpy(result.limb, product + leading, sizeof result.limb);
    result.sign = a->sign * b->sign;
    result.exponent = a->exponent + b->exponent - leading;
    return result;
}

/* a (1 / b), the reciprocal by Newton's iteration x (2 - b x) from a double. */
exact exact_divide(const exact *a, const exact *b)
{
    const exact two = exact_of(2.0);
    exact unit = *b; /* b with its point before the first limb, to be a double of usual size */
    unit.exponent = 1;
    exact x = exact_of(1.0 / exact_rounded(&unit));
    /* 52 bits, twice as many each time. */
    for (int i = 0; i < 5; i++) {
        exact product = exact_multiply(&unit, &x), factor = exact_subtract(&two, &product);
        x = exact_multiply(&x, &factor);
    }
    x.exponent -= b->exponent - 1;
    return exact_multiply(a, &x);
}
