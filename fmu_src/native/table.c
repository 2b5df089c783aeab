/* Values at given times, from a CSV file: the twin of congelation/signals/table.py. */

#include <ctype.h>
#include <errno.h>
#include <locale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "block.h"

/* The longest number, in characters, that is looked at. */
#define LONGEST_NUMBER 400

void table_free(struct table *table)
{
    free(table->times);
    free(table->values);
    table->times = table->values = NULL;
    table->count = 0;
}

/* The number between two places; NaN if there is none. The host's locale may have another decimal
   point than a dot, and strtod goes by that. */
static double number_in(const char *from, const char *to)
{
    char text[LONGEST_NUMBER + 8], *end;
    const char *point = localeconv()->decimal_point;
    size_t used = 0;
    while (from < to && isspace((unsigned char)*from)) from++;
    while (from < to && isspace((unsigned char)to[-1])) to--;
    if (from == to) return NAN;
    for (const char *c = from; c < to; c++) {
        bool between = c > from && c + 1 < to && isdigit((unsigned char)c[-1])
                       && isdigit((unsigned char)c[1]);
        if (used > LONGEST_NUMBER || !strchr("0123456789+-.eE_", *c)) return NAN;
        if (*c == '_' && !between) return NAN;
        if (*c == '_') continue; /* as in Python */
        if (*c == '.') used += (size_t)snprintf(text + used, 8, "%.6s", point);
        else text[used++] = *c;
    }
    text[used] = '\0';
    double value = strtod(text, &end);
    return *end ? NAN : value;
}

/* All of a file, with a NUL behind it; NULL where it cannot be read. */
static char *content_of(const char *name)
{
    FILE *file = fopen(name, "rb");
    size_t size = 0, room = 4096;
    char *text = file ? malloc(room) : NULL;
    while (text) {
        size += fread(text + size, 1, room - 1 - size, file);
        if (ferror(file) || feof(file)) break;
        char *larger = realloc(text, room *= 2);
        if (!larger) free(text);
        text = larger;
    }
    if (text && ferror(file)) {
        free(text);
        text = NULL;
    }
    if (text) text[size] = '\0';
    if (file) {
        int cause = errno;
        fclose(file);
        errno = cause;
    }
    return text;
}

static bool add_row(struct table *table, int *room, double time, double value)
{
    if (table->count == *room) {
        size_t wanted = *room ? 2u * (size_t)*room : 64u;
        double *times = realloc(table->times, wanted * sizeof(double));
        if (times) table->times = times;
        double *values = realloc(table->values, wanted * sizeof(double));
        if (values) table->values = values;
        if (!times || !values) return false;
        *room = (int)wanted;
    }
    table->times[table->count] = time;
    table->values[table->count++] = value;
    return true;
}

/* Whether the last row can stand behind the one before it. */
static bool follows(const struct table *table, struct reason *why)
{
    char one[32], other[32];
    int i = table->count - 1;
    const double *t = table->times, *v = table->values;
    if (i == 0) return true;
    if (!(t[i - 1] < t[i])) {
        explain(why, "time %s does not come after %s", repr_of(t[i], one),
                repr_of(t[i - 1], other));
        return false;
    }
    if (isinf((v[i] - v[i - 1]) / (t[i] - t[i - 1]))) {
        explain(why, "the step from %s to %s is beyond double precision", repr_of(v[i - 1], one),
                repr_of(v[i], other));
        return false;
    }
    return true;
}

/* Two columns time,value; the first line may be a header; what follows a # is a comment. */
static bool rows_of(struct table *table, const char *text, const char *name, struct reason *why)
{
    int room = 0;
    bool header_possible = true;
    struct reason cause;
    if (strncmp(text, "\xEF\xBB\xBF", 3) == 0) text += 3;
    for (int line = 1; *text; line++) {
        size_t length = strcspn(text, "\n\r\v\f"), used = strcspn(text, "#\n\r\v\f");
        const char *from = text, *to = text + used, *comma = memchr(text, ',', used);
        text += length;
        text += text[0] == '\r' && text[1] == '\n' ? 2 : *text ? 1 : 0;
        while (from < to && isspace((unsigned char)*from)) from++;
        while (from < to && isspace((unsigned char)to[-1])) to--;
        if (from == to) continue;
        bool two = comma && !memchr(comma + 1, ',', (size_t)(to - comma) - 1);
        double time = two ? number_in(from, comma) : NAN;
        double value = two ? number_in(comma + 1, to) : NAN;
        if (two && isfinite(time) && isfinite(value)) {
            if (!add_row(table, &room, time, value)) {
                explain(why, "table file '%.200s': there is no memory left", name);
                return false;
            }
            if (!follows(table, &cause)) {
                explain(why, "table file '%.200s', line %d: %.150s", name, line, cause.text);
                return false;
            }
        } else if (!(header_possible && two && isnan(time) && isnan(value))) {
            explain(why,
                    "table file '%.200s', line %d: '%.*s' is not time,value (two finite numbers)",
                    name, line, to - from > 40 ? 40 : (int)(to - from), from);
            return false;
        }
        header_possible = false;
    }
    if (table->count) return true;
    explain(why, "table file '%.200s': no rows; expected two columns time,value", name);
    return false;
}

bool table_read(struct table *table, const char *name, struct reason *why)
{
    table_free(table);
    if (!*name) return true;
    errno = 0;
    char *text = content_of(name);
    if (!text) {
        explain(why, "table file '%.200s': %s", name, errno ? strerror(errno) : "it cannot be read");
        return false;
    }
    bool read = rows_of(table, text, name, why);
    free(text);
    if (!read) table_free(table);
    return read;
}

/* The piece between the times around t. */
void table_piece(struct table *table, double t, double *start, double *end)
{
    const double *times = table->times, *values = table->values;
    int low = 0, high = table->count;
    while (low < high) { /* the first time above t */
        int middle = low + (high - low) / 2;
        if (t < times[middle]) high = middle;
        else low = middle + 1;
    }
    *end = low < table->count ? times[low] : INFINITY;
    *start = table->start = low ? times[low - 1] : -INFINITY;
    table->held = values[low ? low - 1 : 0];
    table->slope = 0.0;
    if (low && table->linear && low < table->count)
        table->slope = (values[low] - values[low - 1]) / (*end - times[low - 1]);
}
