/* Calls in a random order, with random values and damaged states: calls GUID VARIABLES SEED CALLS.

   Linked with the sources of a native FMU under sanitizers, which end the program at a fault. It ends
   itself where a value that is returned with fmi2OK is not a number, or a status is none. With
   LIBFUZZER it is a target of libFuzzer, whose bytes stand in place of the random numbers. */

#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { MOST = 8, INSTANCES = 3, SAVED = 4 };

#ifdef LIBFUZZER
#include "block.h"

static const uint8_t *bytes;
static size_t left;

static unsigned below(unsigned bound)
{
    unsigned value = 0;
    for (unsigned range = 1; range < bound && left; range <<= 8, left--) value = value << 8 | *bytes++;
    return value % bound;
}
#else
static uint64_t seed;

static unsigned below(unsigned bound) /* G. Marsaglia, Xorshift RNGs, J. Stat. Softw. 8(14), 2003 */
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (unsigned)(seed >> 33) % bound;
}
#endif

static double number(void)
{
    static const double special[] = {0.0, -0.0, 1.0, -1.0, 1e300, -1e300, 1e-300, INFINITY, NAN, 5e-324};
    if (below(4) == 0) return special[below(sizeof special / sizeof *special)];
    return ((double)below(1000000) - 500000.0) * (below(3) ? 2e-6 : 1e-4);
}

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                   fmi2String category, fmi2String format, ...)
{
    char text[2000];
    va_list values;
    (void)environment, (void)name, (void)status, (void)category;
    va_start(values, format);
    vsnprintf(text, sizeof text, format, values);
    va_end(values);
}

static fmi2Status checked(fmi2Status status)
{
    if (status > fmi2Pending) fprintf(stderr, "a status is %d\n", (int)status), exit(3);
    return status;
}

static void real_numbers(fmi2Status status, const double *values, size_t count)
{
    if (checked(status) != fmi2OK) return;
    for (size_t i = 0; i < count; i++)
        if (isnan(values[i])) fprintf(stderr, "a value is no number\n"), exit(3);
}

static bool goes_on(long *calls)
{
#ifdef LIBFUZZER
    (void)calls;
    return left > 0;
#else
    return (*calls)-- > 0;
#endif
}

/* How many steps were taken among the calls. */
static long call(const char *guid, unsigned variables, long calls)
{
    const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    fmi2Component made[INSTANCES] = {NULL};
    fmi2FMUstate saved[SAVED] = {NULL};
    double now = 0.0;
    long steps = 0;
    while (goes_on(&calls)) {
        unsigned which = below(INSTANCES), slot = below(SAVED), n = below(MOST + 1);
        fmi2ValueReference vr[MOST], other[MOST];
        fmi2Integer integers[MOST];
        fmi2Boolean yes, no;
        fmi2String strings[MOST];
        double values[MOST], seeds[MOST];
        for (unsigned i = 0; i < MOST; i++) {
            vr[i] = below(variables), other[i] = below(variables);
            integers[i] = (fmi2Integer)below(6) - 1;
            strings[i] = below(2) ? "" : below(2) ? "no file" : "table.csv"; /* test_calls.py writes it */
            values[i] = number(), seeds[i] = number();
        }
        if (!made[which]) {
            made[which] = fmi2Instantiate("one", below(3) ? fmi2CoSimulation : fmi2ModelExchange,
                                          below(20) ? guid : "{}", "", &callbacks, 0, (int)below(2));
            continue;
        }
        fmi2Component c = made[which];
        fmi2EventInfo info;
        size_t size = 0;
        switch (below(24)) {
        case 0: checked(fmi2SetupExperiment(c, (int)below(2), values[0], now = below(3) ? 0.0 : values[1], (int)below(2), values[2])); break;
        case 1: checked(fmi2EnterInitializationMode(c)); break;
        case 2: checked(fmi2ExitInitializationMode(c)); break;
        case 3: case 4: checked(fmi2SetReal(c, vr, n, values)); break;
        case 5: case 6: real_numbers(fmi2GetReal(c, vr, n, values), values, n); break;
        case 7: checked(fmi2SetBoolean(c, vr, n, integers)), checked(fmi2GetBoolean(c, other, n, integers)); break;
        case 8: checked(fmi2SetInteger(c, vr, n, integers)), checked(fmi2GetInteger(c, other, n, integers)); break;
        case 9: checked(fmi2SetString(c, vr, n, strings)), checked(fmi2GetString(c, other, n, strings)); break;
        case 10: checked(fmi2SetRealInputDerivatives(c, vr, n, integers, values)); break;
        case 11: real_numbers(fmi2GetRealOutputDerivatives(c, vr, n, integers, values), values, n); break;
        case 12: real_numbers(fmi2GetDirectionalDerivative(c, vr, n, other, below(MOST + 1), seeds, values), values, n); break;
        case 13: case 14: case 15: {
            double h = below(8) ? 0.01 * (double)below(10) : values[0];
            if (h > 10.0 && h < INFINITY) h = 10.0;
            checked(fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &now));
            if (checked(fmi2DoStep(c, below(8) ? now : values[1], h, (int)below(2))) == fmi2OK) steps++;
            break;
        }
        case 16:
            checked(fmi2EnterEventMode(c));
            checked(fmi2NewDiscreteStates(c, &info));
            checked(fmi2EnterContinuousTimeMode(c));
            break;
        case 17:
            checked(fmi2SetTime(c, values[0]));
            checked(fmi2CompletedIntegratorStep(c, fmi2True, &yes, &no));
            break;
        case 18:
            checked(fmi2SetContinuousStates(c, values, n));
            real_numbers(fmi2GetContinuousStates(c, values, n), values, n);
            real_numbers(fmi2GetNominalsOfContinuousStates(c, values, n), values, n);
            break;
        case 19:
            real_numbers(fmi2GetDerivatives(c, values, n), values, n);
            checked(fmi2GetEventIndicators(c, values, 0));
            break;
        case 20:
            if (below(3)) checked(fmi2GetFMUstate(c, saved + slot));
            else checked(fmi2SetFMUstate(c, saved[slot]));
            break;
        case 21:
            if (saved[slot] && checked(fmi2SerializedFMUstateSize(c, saved[slot], &size)) == fmi2OK) {
                char *data = malloc(size);
                checked(fmi2SerializeFMUstate(c, saved[slot], data, size));
                if (below(2)) data[below((unsigned)size)] ^= (char)(1 << below(8));
                if (below(4) == 0) size = below((unsigned)size + 1);
                fmi2FMUstate read = NULL;
                if (checked(fmi2DeSerializeFMUstate(c, data, size, &read)) == fmi2OK)
                    checked(fmi2SetFMUstate(c, read));
                checked(fmi2FreeFMUstate(c, &read));
                free(data);
            }
            break;
        case 22:
            if (below(4) == 0) checked(fmi2Reset(c));
            else if (below(4) == 0) checked(fmi2Terminate(c));
            break;
        default:
            if (below(10) == 0) fmi2FreeInstance(c), made[which] = NULL;
        }
    }
    for (int i = 0; i < SAVED; i++) fmi2FreeFMUstate(NULL, saved + i);
    for (int i = 0; i < INSTANCES; i++) fmi2FreeInstance(made[i]);
    return steps;
}

#ifdef LIBFUZZER
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    bytes = data;
    left = size;
    call(MODEL_GUID, (unsigned)VARIABLE_COUNT + 2, 0);
    return 0;
}
#else
int main(int count, char **arguments)
{
    if (count != 5) return 2;
    seed = strtoull(arguments[3], NULL, 10) * 2654435761u + 88172645463325252u;
    printf("%ld\n", call(arguments[1], (unsigned)atoi(arguments[2]) + 2, atol(arguments[4])));
    return 0;
}
#endif
