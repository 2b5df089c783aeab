/* A head (format, key of the model, checksum of the body), then the numbers, little-endian, and the
   names of files. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "block.h"

enum { FORMAT = 8, KEY = 32, CHECK = 8, HEAD = FORMAT + KEY + CHECK, NUMBER = 8 };
static const unsigned char MAGIC[FORMAT] = {'c', 'g', 'l', 'n', 'a', 't', 'v', '1'};

static void write_number(uint64_t value, unsigned char *bytes)
{
    for (int i = 0; i < NUMBER; i++) bytes[i] = (unsigned char)(value >> (8 * i));
}

static uint64_t read_number(const unsigned char *bytes)
{
    uint64_t value = 0;
    for (int i = 0; i < NUMBER; i++) value |= (uint64_t)bytes[i] << (8 * i);
    return value;
}

/* FNV-1a: G. Fowler, L. C. Noll, K.-P. Vo, D. Eastlake, RFC 9923. */
static uint64_t checksum(const unsigned char *bytes, size_t size)
{
    uint64_t hash = UINT64_C(0xCBF29CE484222325);
    for (size_t i = 0; i < size; i++) hash = (hash ^ bytes[i]) * UINT64_C(0x100000001B3);
    return hash;
}

size_t serialized_size(const double *state) { return HEAD + saved_size(state); }

/* Numbers and names of files have the same size as bytes as in memory; only the names are copied as
   they are. */
void serialize(const double *state, unsigned char *bytes)
{
    size_t size = saved_size(state);
    unsigned char *body = bytes + HEAD, *files = body + NUMBER * state_length();
    for (size_t i = 0; i < size / NUMBER; i++) {
        uint64_t bits;
        memcpy(&bits, state + i, sizeof bits);
        write_number(bits, body + NUMBER * i);
    }
    memcpy(files, files_of(state), files_size());
    memcpy(bytes, MAGIC, FORMAT);
    memcpy(bytes + FORMAT, MODEL_KEY, KEY);
    write_number(checksum(body, size), bytes + FORMAT + KEY);
}

/* Whether an instance could have come to be in this state, but for what it remembers. */
static bool is_possible(const double *s)
{
    for (size_t i = 0; i < state_length(); i++)
        if (!isfinite(s[i])) return false;
    for (int j = 0; j < PROFILES; j++)
        if (!memchr(files_of(s) + j * FILE_SIZE, '\0', FILE_SIZE)) return false;
    double most = DELAYED ? s[state_length() - (size_t)CONSTANTS + (size_t)CAPACITY] : 0.0;
    bool exchanges = s[KIND] == (double)fmi2ModelExchange;
    return ((exchanges && !DELAYED) || s[KIND] == (double)fmi2CoSimulation)
           && (s[MODE] == INSTANTIATED || s[MODE] == INITIALIZATION || s[MODE] == TERMINATED
               || (exchanges ? s[MODE] == EVENT || s[MODE] == CONTINUOUS : s[MODE] == STEPPING))
           && (s[HAS_STOP] == 0.0 || s[HAS_STOP] == 1.0) && 0.0 < s[TOLERANCE]
           && s[TOLERANCE] < 1.0 && s[INNER_STEP] > 0.0 && s[SINCE] >= 0.0 && 0.0 <= s[PIECES]
           && s[PIECES] <= most && s[PIECES] == floor(s[PIECES]);
}

double *deserialize(const unsigned char *bytes, size_t size, const char **fault)
{
    *fault = "it is no serialised state of a native FMU";
    if (!bytes || size < HEAD || memcmp(bytes, MAGIC, FORMAT) != 0) return NULL;
    *fault = "it is the serialised state of another model or build";
    if (memcmp(bytes + FORMAT, MODEL_KEY, KEY) != 0) return NULL;
    *fault = "it is a serialised state that was truncated or altered";
    const unsigned char *body = bytes + HEAD;
    if (size < HEAD + state_size() || size % NUMBER != 0
        || read_number(bytes + FORMAT + KEY) != checksum(body, size - HEAD))
        return NULL;
    *fault = "there is no memory left";
    double *state = malloc(size - HEAD);
    if (!state) return NULL;
    for (size_t i = 0; i < (size - HEAD) / NUMBER; i++) {
        uint64_t bits = read_number(body + NUMBER * i);
        memcpy(state + i, &bits, sizeof bits);
    }
    memcpy(state + state_length(), body + NUMBER * state_length(), files_size());
    bool possible = is_possible(state) && saved_size(state) == size - HEAD;
    size_t pieces = possible ? (size_t)state[PIECES] * piece_length() : 0;
    for (size_t i = 0; i < pieces; i++) possible = possible && isfinite(pieces_of(state)[i]);
    if (possible) return state;
    *fault = "it is a serialised state that was altered";
    free(state);
    return NULL;
}
