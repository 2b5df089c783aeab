/* The input of the past, kept as the cubics that it was over each step: the twin of
   fmu_src/python/delay.py. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "block.h"

/* A jump of the input counts, and is announced, from this part of its largest value on; see there. */
#define JUMP 1e-3

static size_t count_of(const struct instance *in) { return (size_t)in->state[PIECES]; }

/* The piece number i, from the oldest. */
static double *piece_of(const struct instance *in, size_t i)
{
    return in->ring.pieces + (in->ring.first + i) % in->ring.capacity * piece_length();
}

/* Room for as many pieces as the parameter says; what was in it is forgotten. */
bool ring_open(struct instance *in, struct reason *why)
{
    double wanted = in->constants[CAPACITY];
    in->state[PIECES] = 0.0;
    in->ring.first = 0;
    if (!(wanted >= 1.0)) {
        explain(why, "capacity = %.0f is refused: it must be positive", wanted);
        return false;
    }
    if (in->ring.capacity == (size_t)wanted) return true;
    double *pieces = calloc((size_t)wanted, piece_length() * sizeof(double));
    if (!pieces) {
        explain(why, "capacity = %.0f is refused: there is no memory for so many steps", wanted);
        return false;
    }
    free(in->ring.pieces);
    in->ring.pieces = pieces;
    in->ring.capacity = (size_t)wanted;
    return true;
}

void ring_copy(const struct instance *in, double *pieces)
{
    for (size_t i = 0; i < count_of(in); i++)
        memcpy(pieces + i * piece_length(), piece_of(in, i), piece_length() * sizeof(double));
}

void ring_set(struct instance *in, const double *pieces, size_t count)
{
    in->ring.first = 0;
    in->state[PIECES] = (double)count;
    if (count) memcpy(in->ring.pieces, pieces, count * piece_length() * sizeof(double));
}

/* theta, of which the last is time, and on demand the slopes behind it. */
void delayed_values(struct instance *in, bool slopes)
{
    double t = in->state[TIME], delay = in->constants[DELAY], s = 0.0;
    const double *now = NULL;
    /* The time at which a piece comes out is announced, and is never computed otherwise. */
    for (size_t i = 0; i < count_of(in) && !(piece_of(in, i)[START] + delay > t); i++)
        now = piece_of(in, i);
    if (now) s = lesser(greater(t - delay - now[START], 0.0), now[LENGTH]);
    for (int j = 0; j < DELAYED; j++) {
        const double none[] = {in->constants[BEFORE + j], 0.0, 0.0, 0.0};
        const double *c = now ? now + CUBICS + 4 * j : none;
        in->theta[j] = c[0] + s * (c[1] + s * (c[2] + s * c[3]));
        if (slopes) in->theta[DELAYED + 1 + j] = c[1] + s * (2.0 * c[2] + s * 3.0 * c[3]);
    }
    in->theta[DELAYED] = t;
}

/* Whether inputs of these values do not go on from the memory, and the largest so far. */
static bool jumps(const struct instance *in, const double *values, int stride, double *largest)
{
    const double *last = count_of(in) ? piece_of(in, count_of(in) - 1) : NULL;
    bool apart = false;
    *largest = 0.0;
    for (int j = 0; j < DELAYED; j++) *largest = greater(*largest, fabs(values[j * stride]));
    if (last) *largest = greater(*largest, last[LARGEST]);
    for (int j = 0; j < DELAYED; j++) {
        double ended = in->constants[BEFORE + j];
        if (last) {
            const double *c = last + CUBICS + 4 * j;
            double h = last[LENGTH];
            ended = c[0] + h * (c[1] + h * (c[2] + h * c[3]));
        }
        apart = apart || fabs(values[j * stride] - ended) > JUMP * *largest;
    }
    return apart;
}

/* The next time at which a jump comes out; the inputs' values are those last computed. */
double delayed_event(struct instance *in)
{
    double t = in->state[TIME], delay = in->constants[DELAY], largest;
    for (size_t i = 0; i < count_of(in); i++) {
        const double *piece = piece_of(in, i);
        if (piece[JUMPS] != 0.0 && piece[START] + delay > t) return piece[START] + delay;
    }
    /* A jump of the inputs just set will be part of the memory with the next step. */
    return jumps(in, in->v, 1, &largest) ? t + delay : INFINITY;
}

bool delayed_step(struct instance *in, double t, double h, struct reason *why)
{
    double delay = in->constants[DELAY], largest, total = 0.0;
    size_t count = count_of(in), forgotten = 0;
    input_cubics(in);
    for (int j = 0; j < DELAYED; j++) {
        const double *c = in->cubics + 4 * j;
        total += c[0] + h * (c[1] + h * (c[2] + h * c[3]));
    }
    if (total - total != 0.0) {
        explain(why, "an input leaves the range of floating-point numbers in it; the loop diverges: "
                     "take a smaller communication step");
        return false;
    }
    bool apart = jumps(in, in->cubics, 4, &largest);
    /* What has come out is forgotten, but for the piece that is coming out. */
    while (forgotten < count
           && (forgotten + 1 < count ? piece_of(in, forgotten + 1)[START] : t) + delay <= t + h)
        forgotten++;
    if (count + 1 - forgotten > in->ring.capacity) {
        explain(why,
                "delay = %.9g holds more than %.0f steps of this length; take a longer communication "
                "step, or a shorter delay, or a larger capacity",
                delay, in->constants[CAPACITY]);
        return false;
    }
    in->ring.first = (in->ring.first + forgotten) % in->ring.capacity;
    in->state[PIECES] = (double)(count - forgotten + 1);
    double *piece = piece_of(in, count - forgotten);
    piece[START] = t;
    piece[LENGTH] = h;
    piece[JUMPS] = apart ? 1.0 : 0.0;
    piece[LARGEST] = largest;
    memcpy(piece + CUBICS, in->cubics, 4u * (size_t)DELAYED * sizeof(double));
    return true;
}
