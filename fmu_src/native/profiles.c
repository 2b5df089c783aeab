/* The profiles of theta(t) and of signals: the twin of congelation/signals. */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "block.h"

#define PI 3.141592653589793
/* Half periods, or samples, beyond this many cannot be told apart in double precision. */
#define MOST_PIECES 2251799813685248.0
#define MOST_TELEGRAPH_JUMPS 1e7
/* Events closer than this, relative to max(1, |t|), happen together. */
#define COINCIDENT 1e-12
#define UNIFORMS 12
#define LARGEST_SEED 2147483647.0

/* Steele, Lea and Flood, Fast splittable pseudorandom number generators, OOPSLA 2014. */
static uint64_t splitmix64(uint64_t seed, int64_t k)
{
    uint64_t z = seed + (uint64_t)k * UINT64_C(0x9E3779B97F4A7C15);
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return z ^ (z >> 31);
}

/* The logarithm from + - * / alone, the same on every machine; see signals/telegraph.py. */
static double logarithm(double u)
{
    int e;
    double m = frexp(u, &e), s, series = 0.0;
    if (m < 0.7071067811865476) {
        m = 2.0 * m;
        e -= 1;
    }
    s = (m - 1.0) / (m + 1.0);
    for (int odd = 23; odd > 0; odd -= 2) series = series * (s * s) + 1.0 / odd;
    return e * 0.6931471805599453 + 2.0 * s * series;
}

static struct piece forever(void)
{
    struct piece piece = {-INFINITY, INFINITY, 0.0, false, false, {0.0, 0.0, 0.0, 0.0}};
    return piece;
}

/* amplitude a, period b, phase c */
static double square_jump(const struct term *q, double k) { return (k - q->c / PI) * q->b / 2.0; }

static bool square_piece(const struct term *q, double t, struct piece *piece, struct reason *why)
{
    double turns = 2.0 * (t / q->b), shift = q->c / PI;
    if (!(fabs(turns) + fabs(shift) < MOST_PIECES)) {
        char period[32], phase[32], time[32];
        explain(why,
                "square.period = %s, square.phase = %s: the jumps near t = %s are too close, or "
                "too far from the first, for double precision",
                repr_of(q->b, period), repr_of(q->c, phase), repr_of(t, time));
        return false;
    }
    double k = floor(turns + shift);
    /* The quotient is rounded, the jump times decide. */
    while (square_jump(q, k) > t) k -= 1.0;
    while (square_jump(q, k + 1.0) <= t) k += 1.0;
    piece->start = square_jump(q, k);
    piece->end = square_jump(q, k + 1.0);
    piece->held = fmod(k, 2.0) != 0.0 ? -q->a : q->a;
    return true;
}

/* amplitude a, omega_start b, omega_end c, duration d, phase e */
static void chirp_piece(const struct term *q, double t, struct piece *piece)
{
    piece->wave[0] = q->a;
    if (t < 0.0) {
        piece->end = 0.0;
        piece->smooth = true;
        piece->wave[1] = q->b;
        piece->wave[2] = q->e;
    } else if (t < q->d) {
        piece->start = 0.0;
        piece->end = q->d;
        piece->sweeping = true;
        piece->wave[1] = q->b;
        piece->wave[2] = (q->c - q->b) / (2.0 * q->d);
        piece->wave[3] = q->e;
    } else {
        piece->start = q->d;
        piece->smooth = true;
        piece->wave[1] = q->c;
        piece->wave[2] = q->e - (q->c - q->b) * q->d / 2.0;
    }
}

/* amplitude a, rate b, seed c */
static bool telegraph_piece(struct term *q, double t, struct piece *piece, struct reason *why)
{
    uint64_t seed = (uint64_t)q->c;
    /* The jumps are a sum, so one before those around the last time is found from the start. */
    if (q->jumps < 0 || (q->jumps > 0 && t < q->last)) {
        q->jumps = 0;
        q->last = 0.0;
        q->next = 0.0 - logarithm(((double)(splitmix64(seed, 2) >> 11) + 1.0) * 0x1p-53) / q->b;
    }
    if (q->next <= t && q->b * t > MOST_TELEGRAPH_JUMPS) {
        char rate[32], time[32];
        explain(why, "telegraph.rate = %s: too many jumps until t = %s", repr_of(q->b, rate),
                repr_of(t, time));
        return false;
    }
    while (q->next <= t) {
        q->last = q->next;
        q->jumps++;
        q->next -= logarithm(((double)(splitmix64(seed, q->jumps + 2) >> 11) + 1.0) * 0x1p-53)
                   / q->b;
    }
    piece->start = q->jumps ? q->last : -INFINITY;
    piece->end = q->next;
    piece->held = ((splitmix64(seed, 1) >> 63) ^ ((uint64_t)q->jumps & 1u)) ? -q->a : q->a;
    return true;
}

/* deviation a, sample_time b, seed c */
static bool noise_piece(const struct term *q, double t, struct piece *piece, struct reason *why)
{
    double samples = t / q->b;
    if (!(fabs(samples) < MOST_PIECES)) {
        char width[32], time[32];
        explain(why,
                "noise.sample_time = %s: the samples near t = %s are too short for double "
                "precision",
                repr_of(q->b, width), repr_of(t, time));
        return false;
    }
    double k = floor(samples), total = 0.0;
    while (k * q->b > t) k -= 1.0;
    while ((k + 1.0) * q->b <= t) k += 1.0;
    for (int64_t j = UNIFORMS * (int64_t)k + 1; j <= UNIFORMS * ((int64_t)k + 1); j++)
        total += (double)(splitmix64((uint64_t)q->c, j) >> 11) * 0x1p-53;
    piece->start = k * q->b;
    piece->end = (k + 1.0) * q->b;
    piece->held = q->a * (total - 6.0);
    return true;
}

static bool term_piece(struct term *term, double t, struct piece *piece, struct reason *why)
{
    *piece = forever();
    switch (term->kind) {
    case SQUARE: return square_piece(term, t, piece, why);
    case CHIRP: chirp_piece(term, t, piece); return true;
    case TELEGRAPH: return telegraph_piece(term, t, piece, why);
    default: return noise_piece(term, t, piece, why);
    }
}

/* -- from constants --------------------------------------------------------------------------- */

static bool is_above_zero(const char *profile, const char *kind, int k, const char *field,
                          double value, struct reason *why)
{
    char text[32];
    if (value > 0.0) return true;
    explain(why, "%s: %s[%d].%s = %s: must be a finite number above 0", profile, kind, k, field,
            repr_of(value, text));
    return false;
}

static bool is_seed(const char *profile, const char *kind, int k, double value, struct reason *why)
{
    if (0.0 <= value && value <= LARGEST_SEED) return true;
    explain(why, "%s: %s[%d].seed = %.0f: must be an integer from 0 to %.0f", profile, kind, k,
            value, LARGEST_SEED);
    return false;
}

static void add_term(struct profile *profile, enum kind kind, const double *c, int fields)
{
    double values[5] = {0.0, 0.0, 0.0, 0.0, 0.0};
    memcpy(values, c, (size_t)fields * sizeof(double));
    struct term term = {kind, "", values[0], values[1], values[2], values[3], values[4],
                        -1, 0.0, 0.0};
    profile->terms[profile->term_count++] = term;
}

static void add_sine(struct profile *profile, double a, double omega, double phase)
{
    double *sine = profile->sines[profile->sine_count++];
    sine[0] = a;
    sine[1] = omega;
    sine[2] = phase;
}

/* The terms in the order of their kinds; those of amplitude 0 are checked, then dropped. */
bool profile_bind(struct profile *profile, const struct profile_slots *slots,
                  const double *constants, const char *file, struct reason *why)
{
    const char *name = slots->name;
    struct reason cause;
    profile->sine_count = profile->term_count = 0;
    profile->held = constants[slots->mean];
    for (int k = 0; k < slots->sines; k++) {
        const double *c = constants + slots->sine + 3 * k;
        if (c[0] != 0.0) add_sine(profile, c[0], c[1], c[2]);
    }
    for (int k = 0; k < slots->squares; k++) {
        const double *c = constants + slots->square + 3 * k;
        if (!is_above_zero(name, "square", k + 1, "period", c[1], why)) return false;
        if (c[0] != 0.0) add_term(profile, SQUARE, c, 3);
    }
    for (int k = 0; k < slots->chirps; k++) {
        const double *c = constants + slots->chirp + 5 * k;
        if (!is_above_zero(name, "chirp", k + 1, "duration", c[3], why)) return false;
        if (c[0] != 0.0 && c[1] == c[2]) add_sine(profile, c[0], c[1], c[4]);
        else if (c[0] != 0.0) add_term(profile, CHIRP, c, 5);
    }
    for (int k = 0; k < slots->telegraphs; k++) {
        const double *c = constants + slots->telegraph + 3 * k;
        if (!is_above_zero(name, "telegraph", k + 1, "rate", c[1], why)) return false;
        if (!is_seed(name, "telegraph", k + 1, c[2], why)) return false;
        if (c[0] != 0.0) add_term(profile, TELEGRAPH, c, 3);
    }
    for (int k = 0; k < slots->noises; k++) {
        const double *c = constants + slots->noise + 3 * k;
        if (!is_above_zero(name, "noise", k + 1, "sample_time", c[1], why)) return false;
        if (!is_seed(name, "noise", k + 1, c[2], why)) return false;
        if (c[0] != 0.0) add_term(profile, NOISE, c, 3);
    }
    profile->table.linear = slots->linear >= 0 && constants[slots->linear] != 0.0;
    if (table_read(&profile->table, file, &cause)) return true;
    explain(why, "%s: table.file: %s", name, cause.text);
    return false;
}

/* -- evaluation ------------------------------------------------------------------------------- */

static bool pieces_at(struct profile *profile, double t, double *start, double *end,
                      struct reason *why)
{
    *start = -INFINITY;
    *end = INFINITY;
    for (int i = 0; i < profile->term_count; i++) {
        if (!term_piece(profile->terms + i, t, profile->pieces + i, why)) return false;
        *start = greater(*start, profile->pieces[i].start);
        *end = lesser(*end, profile->pieces[i].end);
    }
    if (profile->table.count) {
        double first, last;
        table_piece(&profile->table, t, &first, &last);
        *start = greater(*start, first);
        *end = lesser(*end, last);
    }
    return true;
}

/* The piece at t. Events within COINCIDENT after another one are taken to happen with it. */
bool profile_segment(struct profile *profile, double t, double *start, double *end,
                     struct reason *why)
{
    if (!pieces_at(profile, t, start, end, why)) return false;
    if (*start > -INFINITY) {
        double first = *start, ignored;
        double settled = first + COINCIDENT * greater(1.0, fabs(first));
        if (*end <= settled && !pieces_at(profile, settled, &ignored, end, why)) return false;
        *start = first;
    }
    const struct table *table = &profile->table;
    profile->start = *start;
    profile->level = profile->held;
    for (int i = 0; i < profile->term_count; i++) profile->level += profile->pieces[i].held;
    if (table->count) profile->level += table->held;
    if (table->count && table->slope != 0.0)
        profile->level += table->slope * (profile->start - table->start);
    return true;
}

double profile_value(const struct profile *profile, double t)
{
    double total = profile->level;
    const struct table *table = &profile->table;
    for (int i = 0; i < profile->sine_count; i++) {
        const double *w = profile->sines[i];
        total += w[0] * sin(w[1] * t + w[2]);
    }
    for (int i = 0; i < profile->term_count; i++) {
        const double *w = profile->pieces[i].wave;
        if (profile->pieces[i].smooth) total += w[0] * sin(w[1] * t + w[2]);
    }
    if (table->count && table->slope != 0.0) total += table->slope * (t - profile->start);
    for (int i = 0; i < profile->term_count; i++) {
        const double *w = profile->pieces[i].wave;
        if (profile->pieces[i].sweeping) total += w[0] * sin((w[1] + w[2] * t) * t + w[3]);
    }
    return total;
}

double profile_derivative(const struct profile *profile, double t)
{
    double total = profile->table.count ? profile->table.slope : 0.0;
    for (int i = 0; i < profile->sine_count; i++) {
        const double *w = profile->sines[i];
        total += w[0] * w[1] * cos(w[1] * t + w[2]);
    }
    for (int i = 0; i < profile->term_count; i++) {
        const double *w = profile->pieces[i].wave;
        if (profile->pieces[i].smooth) total += w[0] * w[1] * cos(w[1] * t + w[2]);
    }
    for (int i = 0; i < profile->term_count; i++) {
        const double *w = profile->pieces[i].wave;
        if (profile->pieces[i].sweeping)
            total += w[0] * (w[1] + 2.0 * w[2] * t) * cos((w[1] + w[2] * t) * t + w[3]);
    }
    return total;
}
