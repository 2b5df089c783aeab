/* Messages: to the host's logger, and the numbers in them as Python writes them. */

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "block.h"

void explain(struct reason *why, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(why->text, sizeof why->text, format, arguments);
    va_end(arguments);
}

/* Errors are reported whatever loggingOn says (FMI 2.0.4, 2.1.5). */
void report(const struct instance *instance, fmi2Status status, const char *format, ...)
{
    static const char *const categories[] = {"logAll", "logStatusWarning", "logStatusDiscard",
                                             "logStatusError", "logStatusFatal"};
    char text[1000], whole[2000];
    size_t used = 0;
    va_list arguments;
    if (status < fmi2Error && !instance->logging) return;
    int head = snprintf(text, sizeof text, "%s: ", instance->name);
    if (head < 0 || head >= (int)sizeof text) head = 0;
    va_start(arguments, format);
    vsnprintf(text + head, sizeof text - (size_t)head, format, arguments);
    va_end(arguments);
    /* The logger takes a format; many hosts print it as it is, so it is the text itself. */
    for (const char *c = text; *c; c++) {
        if (*c == '%') whole[used++] = '%';
        whole[used++] = *c;
    }
    whole[used] = '\0';
    instance->callbacks->logger(instance->callbacks->componentEnvironment, instance->name, status,
                                categories[status], whole);
}

fmi2Status illegal(const struct instance *in, const char *function)
{
    static const char *const when[] = {"before fmi2EnterInitializationMode",
                                       "in initialization mode",
                                       "after initialization",
                                       "in event mode",
                                       "in continuous-time mode",
                                       "after fmi2Terminate"};
    report(in, fmi2Error, "%s was called %s of %s", function, when[mode_of(in)],
           exchanges(in) ? "a model exchange" : "a co-simulation");
    return fmi2Error;
}

/* The shortest decimal that reads back as `value`, in the form of Python's repr. */
const char *repr_of(double value, char text[32])
{
    char scientific[32], digits[20];
    int precision, exponent, count = 0, i;
    char *out = text;
    if (isnan(value)) return strcpy(text, "nan");
    if (isinf(value)) return strcpy(text, value < 0.0 ? "-inf" : "inf");
    for (precision = 0; precision < 17; precision++) {
        snprintf(scientific, sizeof scientific, "%.*e", precision, value);
        if (strtod(scientific, NULL) == value) break;
    }
    exponent = atoi(strchr(scientific, 'e') + 1);
    for (i = 0; scientific[i] != 'e'; i++)
        if (scientific[i] >= '0' && scientific[i] <= '9') digits[count++] = scientific[i];
    if (signbit(value)) *out++ = '-';
    if (exponent < -4 || exponent >= 16) {
        *out++ = digits[0];
        if (count > 1) *out++ = '.';
        for (i = 1; i < count; i++) *out++ = digits[i];
        snprintf(out, (size_t)(text + 32 - out), "e%c%02d", exponent < 0 ? '-' : '+', abs(exponent));
        return text;
    }
    if (exponent < 0) {
        *out++ = '0';
        *out++ = '.';
        for (i = -1; i > exponent; i--) *out++ = '0';
        for (i = 0; i < count; i++) *out++ = digits[i];
    } else {
        for (i = 0; i <= exponent || i < count; i++) {
            if (i == exponent + 1) *out++ = '.';
            *out++ = i < count ? digits[i] : '0';
        }
        if (count <= exponent + 1) {
            *out++ = '.';
            *out++ = '0';
        }
    }
    *out = '\0';
    return text;
}
