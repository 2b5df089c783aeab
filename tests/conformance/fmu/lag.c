/* A correct co-simulation FMU (FMI 2.0) for testing the conformance rules, and many broken ones.
 *
 *     x' = u - k x  (if active),  y = +-g x,  w = x + a u + table[1] + table[2]
 *
 * solved exactly, so that the size of the steps does not matter; a comes from a resource. As a model
 * exchange it has a time event every quarter of a second, at which nothing changes. With a mutation
 * chosen it is broken in the way that the name says. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <fenv.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmi2Functions.h"
#ifdef MUTATION_function_missing
#undef fmi2CancelStep
#define fmi2CancelStep not_exported
#endif

/* The names of mutations are written behind the colon of a compiled library, each followed by a
   blank (lag.py); those that change how it is linked are compiled in. */
static char chosen[128] = "chosen mutations: ";

static int is_chosen(const char *mutation)
{
    const char *found = strstr(chosen, mutation);
    size_t length = strlen(mutation);
    while (found && !(found[-1] == ' ' && found[length] == ' ')) found = strstr(found + 1, mutation);
    return found != NULL;
}

#define MUTANT(name) is_chosen(#name)

#define GUID "{4f8a1d52-6f0e-4a53-9a55-2f7c0b1d9e01}"
#define LABEL 64

enum { TIME, U, K, G, ANSWER, TWICE_K, X, DER_X, Y, W, TABLE_1, TABLE_2, REALS };
enum { FIRST = 100, SIGN, STEPS, INTEGERS_END };
enum { ACTIVE = 200, NAME = 300 };
enum { PLUS = 1, MINUS = 3 };

typedef enum {
    INSTANTIATED, INITIALIZATION, STEPPING, FAILED, TERMINATED, BROKEN, EVENT, CONTINUOUS
} Mode;

/* Everything that a simulation needs to go on; plain data, so that a copy is a state. */
typedef struct {
    char magic[8];
    Mode mode;
    int set_up, stop_defined, exchange;
    double real[REALS];
    double slope, stop, last_size;
    int first, sign, steps, active;
    char label[LABEL];
    char end[8];
} State;

typedef struct {
    State now;
    double feedthrough;
    char *name;
    fmi2CallbackFunctions callbacks;
    int logging;
    int events, discards, errors;
    const char *borrowed;
} Instance;

static const State FRESH = {
    .magic = "lag 1",
    .end = "end",
    .real = {[U] = 0.25, [K] = 1.5, [G] = 2.0, [ANSWER] = 42.0, [X] = 1.0},
    .first = 3,
    .sign = PLUS,
    .active = 1,
    .label = "one",
};

static State fresh(void)
{
    State s = FRESH;
    if (MUTANT(start_differs)) s.real[K] = 1.6;
    if (MUTANT(more_digits)) s.real[G] = 2.0 / 3.0;
    return s;
}

/* For mutations that carry something from one call or instance to another. */
static State *shared;
static int counter;
static double poison;

static fmi2Status report(Instance *i, fmi2Status status, const char *format, ...)
{
    const char *category = status == fmi2OK ? "logEvents"
                         : status == fmi2Discard ? "logStatusDiscard" : "logStatusError";
    int wanted = status == fmi2OK ? i->events : status == fmi2Discard ? i->discards : i->errors;
    int chosen = MUTANT(category_ignored) ? i->events + i->discards + i->errors : wanted;
    /* Errors are always told; the rest only while its category is switched on. */
    int told = status >= fmi2Error || (i->logging && chosen);
    if (MUTANT(logs_always)) told = 1;
    if (MUTANT(refusals_unexplained) && status != fmi2OK) told = 0;
    if (MUTANT(errors_need_logging)) told = i->logging && chosen;
    if (told) {
        char text[256];
        va_list arguments;
        va_start(arguments, format);
        vsnprintf(text, sizeof text - 2, format, arguments);
        va_end(arguments);
        if (MUTANT(line_break_logged)) strcat(text, "\n");
        if (MUTANT(arguments_logged)) {
            i->callbacks.logger(i->callbacks.componentEnvironment, i->name, status, category,
                                "%s, %d of %s, %.1f and %lu", text, 12, "lag", 0.5, 7ul);
            return status;
        }
        i->callbacks.logger(i->callbacks.componentEnvironment, i->name, status,
                            MUTANT(category_unknown) ? "logSomething" : category, text);
    }
    if (status == fmi2Error) i->now.mode = BROKEN;
    return status;
}

static fmi2Status expect(Instance *i, int allowed, const char *call)
{
    if (allowed || MUTANT(mode_unchecked)) return fmi2OK;
    if (MUTANT(forbidden_call_crashes)) abort();
    return report(i, fmi2Error, "%s is not allowed in this state", call);
}

static int in_exchange(const Instance *i)
{
    return i->now.mode == EVENT || i->now.mode == CONTINUOUS;
}

/* ---- library ---- */

__attribute__((constructor)) static void loaded(void)
{
    if (!MUTANT(reload_refused)) return;
    if (getenv("LAG_LOADED")) abort();
    setenv("LAG_LOADED", "1", 1);
}

__attribute__((destructor)) static void unloaded(void)
{
    if (MUTANT(exit_crashes)) abort();
}
#ifdef MUTATION_needs_its_host
extern int Py_IsInitialized(void);
#endif

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return MUTANT(version_wrong) ? "2.1" : "2.0"; }

/* ---- instances ---- */

static int decoded(const char *text, char *path, size_t size)
{
    size_t n = 0;
    for (; *text && n + 1 < size; ++text) {
        unsigned code;
        int percent = *text == '%' && sscanf(text + 1, "%2x", &code) == 1;
        if (MUTANT(nothing_decoded)) percent = 0;
        if (MUTANT(space_alone_decoded) && percent && code != ' ') percent = 0;
        path[n++] = percent ? (char)code : *text;
        if (percent) text += 2;
    }
    path[n] = '\0';
    return n + 1 < size;
}

/* The path of a file URI: file:/p, file:///p or file://localhost/p. */
static int path_of(const char *uri, char *path, size_t size)
{
    if (strncmp(uri, "file:", 5) != 0) return 0;
    uri += 5;
    if (strncmp(uri, "//", 2) == 0) {
        const char *authority = uri + 2;
        uri = strchr(authority, '/');
        if (uri == NULL) return 0;
        if (MUTANT(authority_empty_refused) && uri == authority) return 0;
        if (MUTANT(authority_refused) && uri != authority) return 0;
    } else if (MUTANT(authority_required)) {
        return 0;
    }
    return decoded(uri, path, size);
}

static int read_resource(Instance *i, const char *uri)
{
    char path[4096];
    if (!path_of(uri, path, sizeof path - 32)) return 0;
    strcat(path, "/feedthrough.txt");
    FILE *file = fopen(path, "r");
    if (file == NULL) return 0;
    int found = fscanf(file, "%lf", &i->feedthrough);
    if (!MUTANT(file_left_open)) fclose(file);
    if (MUTANT(process_wide_setting)) {
        char text[32];
        snprintf(text, sizeof text, "%g", i->feedthrough);
        setenv("LAG_FEEDTHROUGH", text, 1);
    }
    return found == 1;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String uri,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging)
{
    (void)visible;
    if (MUTANT(second_instance_refused) && counter++ > 0) return NULL;
    if (MUTANT(instantiated_once) && counter++ > 0) abort();
    Instance *i = calloc(1, sizeof *i);
    if (MUTANT(memory_function_used)) {
        functions->freeMemory(functions->allocateMemory(1, 64));
    }
    i->callbacks = *functions;
    i->name = strdup(MUTANT(instance_name_wrong) ? "lag" : name);
    i->now = fresh();
    i->now.exchange = type == fmi2ModelExchange;
    i->logging = logging;
    i->events = i->discards = i->errors = 1;
    if (MUTANT(large_leak)) memset(malloc(100000), 1, 100000);
    if (MUTANT(small_leak)) memset(malloc(5000), 1, 5000);
    if (MUTANT(directory_changed) && chdir("/") != 0) abort();
    if (MUTANT(rounding_changed)) fesetround(FE_UPWARD);
    if (MUTANT(python_expected) && dlsym(RTLD_DEFAULT, "Py_IsInitialized") == NULL) abort();
#ifdef MUTATION_needs_its_host
    if (!Py_IsInitialized()) abort();
#endif
    if (MUTANT(instantiation_fails)) {
        report(i, fmi2Error, "there is no licence");
        free(i->name);
        free(i);
        return NULL;
    }
    int known = MUTANT(guid_unchecked) || strcmp(guid, GUID) == 0;
    if ((type != fmi2CoSimulation && type != fmi2ModelExchange) || !known || !read_resource(i, uri)) {
        if (!MUTANT(refusal_unexplained)) {
            report(i, fmi2Error, "type, GUID or resource location are not those of this FMU");
        }
        free(i->name);
        free(i);
        return NULL;
    }
    return i;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *i = c;
    if (i == NULL) {
        if (MUTANT(null_freed)) abort();
        return;
    }
    if (MUTANT(free_crashes_early) && i->now.mode < STEPPING) abort();
    if (MUTANT(second_instance_refused)) counter = 0;
    free(i->name);
    free(i);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[])
{
    Instance *i = c;
    i->logging = on;
    i->events = i->discards = i->errors = n == 0;
    for (size_t k = 0; k < n; ++k) {
        if (strcmp(names[k], "logAll") == 0) i->events = i->discards = i->errors = 1;
        if (strcmp(names[k], "logEvents") == 0) i->events = 1;
        if (strcmp(names[k], "logStatusDiscard") == 0) i->discards = 1;
        if (strcmp(names[k], "logStatusError") == 0) i->errors = 1;
    }
    return fmi2OK;
}

/* ---- state machine ---- */

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop)
{
    Instance *i = c;
    (void)tolerance;
    if (expect(i, i->now.mode == INSTANTIATED, "fmi2SetupExperiment")) return fmi2Error;
    if (MUTANT(tolerance_refused) && tolerance_defined) return fmi2Error;
    if (MUTANT(first_setup_counts) && i->now.set_up) return fmi2OK;
    i->now.set_up = 1;
    i->now.real[TIME] = MUTANT(start_time_ignored) ? 0.0 : start;
    i->now.stop_defined = stop_defined && !MUTANT(stop_time_unchecked);
    i->now.stop = stop;
    if (MUTANT(stop_time_matters) && stop_defined) i->now.real[X] += 1e-3;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *i = c;
    int allowed = i->now.mode == INSTANTIATED && i->now.set_up;
    if (expect(i, allowed, "fmi2EnterInitializationMode")) return fmi2Error;
    i->now.steps = i->now.first;
    i->now.mode = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *i = c;
    if (expect(i, i->now.mode == INITIALIZATION, "fmi2ExitInitializationMode")) return fmi2Error;
    if (MUTANT(initialization_fails)) return fmi2Error;
    if (MUTANT(input_must_rest) && i->now.real[U] != 0.25) return report(i, fmi2Error, "singular");
    i->now.mode = i->now.exchange ? EVENT : STEPPING;
    if (MUTANT(shared_state)) shared = &i->now;
    if (MUTANT(input_cleared)) i->now.real[U] = 0.0;
    return report(i, fmi2OK, "initialized at %g", i->now.real[TIME]);
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    Instance *i = c;
    int allowed = i->now.mode == STEPPING || i->now.mode == FAILED || in_exchange(i);
    if (expect(i, allowed, "fmi2Terminate")) return fmi2Error;
    i->now.mode = TERMINATED;
    if (MUTANT(values_lost_at_the_end)) i->now.real[X] = 0.0;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *i = c;
    if (MUTANT(failure_is_final) && i->now.mode >= FAILED && i->now.mode != TERMINATED) return fmi2Error;
    if (MUTANT(reset_refused) && i->now.mode == TERMINATED) return fmi2Error;
    double x = i->now.real[X], k = i->now.real[K], u = i->now.real[U];
    Mode before = i->now.mode;
    int exchange = i->now.exchange;
    i->now = fresh();
    i->now.exchange = exchange;
    if (MUTANT(state_survives_reset) && before == STEPPING) i->now.real[X] = x;
    if (MUTANT(exchange_survives_reset) && before == CONTINUOUS) i->now.real[X] = x;
    if (MUTANT(parameter_survives_reset)) i->now.real[K] = k;
    if (MUTANT(input_error_survives_reset) && !isfinite(u)) poison = 1.0;
    if (MUTANT(parameter_error_survives_reset) && !isfinite(k)) poison = 1.0;
    i->now.real[X] += poison;
    if (MUTANT(hundredth_fault_crashes) && before == BROKEN && ++counter == 100) abort();
    return fmi2OK;
}

/* ---- values ---- */

static double slope(const State *s)
{
    double x = s->real[X];
    double k = s->real[K] * (s->exchange && MUTANT(exchange_has_another_law) ? 1.25 : 1.0);
    return s->active ? s->real[U] - k * x : 0.0;
}

static double real_of(const Instance *i, fmi2ValueReference r)
{
    const State *s = MUTANT(shared_state) && shared ? shared : &i->now;
    double sign = s->sign == MINUS ? -1.0 : 1.0, a = i->feedthrough;
    if (MUTANT(process_wide_setting)) a = atof(getenv("LAG_FEEDTHROUGH"));
    switch (r) {
    case TIME: return s->real[TIME] - (MUTANT(clock_late) ? s->last_size : 0.0);
    case TABLE_1: return MUTANT(negative_zero) && counter++ % 2 ? -0.0 : s->real[TABLE_1];
    case TWICE_K: return 2.0 * s->real[K];
    case DER_X: return slope(s);
    case Y: return sign * s->real[G] * s->real[X];
    case W: return s->real[X] + a * s->real[U] + s->real[TABLE_1] + s->real[TABLE_2];
    default: return s->real[r];
    }
}

static fmi2Status unknown(Instance *i, const char *call, fmi2ValueReference r)
{
    if (MUTANT(unknown_reference_crashes)) abort();
    if (MUTANT(unknown_reference_accepted)) return fmi2OK;
    return report(i, fmi2Error, "%s: there is no variable ##%u", call, r);
}

static int readable(Instance *i)
{
    return i->now.mode != INSTANTIATED && !(MUTANT(get_refused_early) && i->now.mode == INITIALIZATION);
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[])
{
    Instance *i = c;
    if (expect(i, readable(i), "fmi2GetReal")) return fmi2Error;
    if (MUTANT(empty_call_refused) && n == 0) return fmi2Error;
    if (MUTANT(reading_moves)) i->now.real[X] += 1e-9;
    for (size_t k = 0; k < n; ++k) {
        int other = r[k] >= FIRST && r[k] < INTEGERS_END;
        if (MUTANT(wrong_type_accepted) && other) continue;
        if (r[k] >= REALS) return unknown(i, "fmi2GetReal", r[k]);
        value[k] = real_of(i, MUTANT(order_of_references_ignored) && n > 1 && r[0] > r[1] ? r[n - 1 - k] : r[k]);
    }
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer value[])
{
    Instance *i = c;
    if (expect(i, readable(i), "fmi2GetInteger")) return fmi2Error;
    for (size_t k = 0; k < n; ++k) {
        if (r[k] == FIRST) value[k] = i->now.first;
        else if (r[k] == SIGN) value[k] = i->now.sign;
        else if (r[k] == STEPS) value[k] = i->now.steps;
        else if (MUTANT(wrong_type_accepted) && r[k] < REALS) value[k] = 0;
        else return unknown(i, "fmi2GetInteger", r[k]);
    }
    return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean value[])
{
    Instance *i = c;
    if (expect(i, readable(i), "fmi2GetBoolean")) return fmi2Error;
    for (size_t k = 0; k < n; ++k) {
        if (r[k] != ACTIVE) return unknown(i, "fmi2GetBoolean", r[k]);
        value[k] = i->now.active * (MUTANT(boolean_is_two) && i->now.steps > 5 ? 2 : 1);
    }
    return fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String value[])
{
    Instance *i = c;
    if (expect(i, readable(i), "fmi2GetString")) return fmi2Error;
    for (size_t k = 0; k < n; ++k) {
        if (r[k] != NAME) return unknown(i, "fmi2GetString", r[k]);
        value[k] = i->borrowed ? i->borrowed : i->now.label;
    }
    return fmi2OK;
}

/* Start values before the steps, inputs and tunable parameters at communication points. */
static int settable(const Instance *i, fmi2ValueReference r)
{
    if (r == U) return i->now.mode == INITIALIZATION || i->now.mode == STEPPING || in_exchange(i);
    if (r == G && i->now.mode == STEPPING && !MUTANT(tunable_refused)) return 1;
    return i->now.mode == INSTANTIATED || i->now.mode == INITIALIZATION;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real value[])
{
    Instance *i = c;
    for (size_t k = 0; k < n; ++k) {
        int constant = r[k] == ANSWER || r[k] == TIME;
        int known = r[k] == U || r[k] == K || r[k] == G || r[k] == X || r[k] == TABLE_1 || r[k] == TABLE_2;
        if (MUTANT(constant_accepted) && constant) continue;
        if (MUTANT(wrong_type_accepted) && r[k] >= FIRST && r[k] < INTEGERS_END) continue;
        if (!known) return unknown(i, "fmi2SetReal", r[k]);
        if (expect(i, settable(i, r[k]), "fmi2SetReal")) return fmi2Error;
        int bad = !isfinite(value[k]) || fabs(value[k]) > 1e300 || (r[k] == K && value[k] <= 0.0);
        if (MUTANT(bad_input_crashes) && bad && r[k] == U) abort();
        if (MUTANT(input_error_survives_reset) && r[k] == U) bad = 0;
        if (MUTANT(parameter_error_survives_reset) && r[k] == K) bad = 0;
        if (bad) return report(i, fmi2Error, "%g is no value for variable ##%u", value[k], r[k]);
        if (!(MUTANT(set_ignored) && r[k] == K)) i->now.real[r[k]] = value[k];
        if (r[k] == U) i->now.slope = 0.0;
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer value[])
{
    Instance *i = c;
    for (size_t k = 0; k < n; ++k) {
        if (MUTANT(wrong_type_accepted) && r[k] < REALS) continue;
        if (r[k] != FIRST && r[k] != SIGN) return unknown(i, "fmi2SetInteger", r[k]);
        if (expect(i, settable(i, r[k]), "fmi2SetInteger")) return fmi2Error;
        int bad = r[k] == FIRST ? value[k] < 0 || value[k] > 1000
                                : value[k] != PLUS && value[k] != MINUS;
        if (MUTANT(bad_integer_crashes) && bad) abort();
        if (bad) return report(i, fmi2Discard, "%d is no value for variable ##%u", value[k], r[k]);
        *(r[k] == FIRST ? &i->now.first : &i->now.sign) = value[k];
    }
    return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean value[])
{
    Instance *i = c;
    for (size_t k = 0; k < n; ++k) {
        if (r[k] != ACTIVE) return unknown(i, "fmi2SetBoolean", r[k]);
        if (expect(i, settable(i, r[k]), "fmi2SetBoolean")) return fmi2Error;
        i->now.active = value[k];
    }
    return fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String value[])
{
    Instance *i = c;
    for (size_t k = 0; k < n; ++k) {
        if (r[k] != NAME) return unknown(i, "fmi2SetString", r[k]);
        if (expect(i, settable(i, r[k]), "fmi2SetString")) return fmi2Error;
        if (strlen(value[k]) >= LABEL) return report(i, fmi2Discard, "the label is too long");
        strcpy(i->now.label, value[k]);
        if (MUTANT(string_not_copied)) i->borrowed = value[k];
    }
    return fmi2OK;
}

/* ---- the complete state ---- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    Instance *i = c;
    static State only;
    if (MUTANT(state_crashes)) abort();
    if (MUTANT(state_unsupported)) return fmi2Error;
    if (MUTANT(one_state_for_all)) *state = &only;
    if (*state != NULL && MUTANT(former_handle_kept)) return fmi2OK;
    if (*state == NULL) *state = malloc(sizeof(State));
    *(State *)*state = i->now;
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    Instance *i = c;
    State before = i->now;
    i->now = *(State *)state;
    if (MUTANT(exchange_state_without_x) && i->now.exchange) i->now.real[X] = before.real[X];
    if (MUTANT(state_without_x)) i->now.real[X] = before.real[X];
    if (MUTANT(state_without_inputs)) i->now.real[U] = before.real[U];
    if (MUTANT(state_without_mode)) i->now.mode = before.mode;
    if (MUTANT(error_is_final) && before.mode != i->now.mode && before.mode >= FAILED && before.mode != TERMINATED) {
        i->now.mode = before.mode;
    }
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    if (MUTANT(one_state_for_all)) return fmi2OK;
    free(*state);
    if (!MUTANT(freed_state_kept)) *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c;
    (void)state;
    *size = MUTANT(size_too_small) ? sizeof(State) - 16 : sizeof(State);
    if (MUTANT(address_serialized)) *size = sizeof(State *);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    Instance *i = c;
    if (MUTANT(serializing_unsupported)) return fmi2Error;
    if (MUTANT(address_serialized)) {
        State *copy = malloc(sizeof *copy);
        *copy = *(State *)state;
        memcpy(bytes, &copy, sizeof copy);
        return fmi2OK;
    }
    if (MUTANT(size_too_small)) {
        memcpy(bytes, state, sizeof(State));
        return fmi2OK;
    }
    if (size != sizeof(State)) return report(i, fmi2Error, "a state has another size");
    memcpy(bytes, state, size);
    if (MUTANT(digits_lost)) {
        double *x = &((State *)bytes)->real[X];
        *x = (float)*x;
    }
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    Instance *i = c;
    const State *s = (const State *)bytes;
    if (MUTANT(address_serialized)) {
        memcpy(state, bytes, sizeof *state);
        return fmi2OK;
    }
    int genuine = size == sizeof(State) && memcmp(s->magic, FRESH.magic, sizeof s->magic) == 0
               && memcmp(s->end, FRESH.end, sizeof s->end) == 0;
    if (MUTANT(size_too_small)) genuine = 1;
    if (!genuine && MUTANT(spoiled_bytes_crash)) abort();
    if (!genuine && MUTANT(spoiled_bytes_accepted)) {
        *state = malloc(sizeof(State));
        *(State *)*state = i->now;
        return fmi2OK;
    }
    if (!genuine) return report(i, fmi2Error, "these bytes are no state of this FMU");
    *state = malloc(sizeof(State));
    memcpy(*state, bytes, size < sizeof(State) ? size : sizeof(State));
    return fmi2OK;
}

/* ---- derivatives ---- */

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t m,
                                        const fmi2ValueReference knowns[], size_t n,
                                        const fmi2Real seed[], fmi2Real result[])
{
    Instance *i = c;
    for (size_t k = 0; k < m; ++k) {
        result[k] = 0.0;
        for (size_t j = 0; j < n; ++j) {
            if (knowns[j] == X) {
                if (unknowns[k] == DER_X && !MUTANT(jacobian_forgotten)) result[k] -= i->now.active * i->now.real[K] * seed[j];
                if (unknowns[k] == W) result[k] += seed[j];
                continue;
            }
            if (knowns[j] != U) return unknown(i, "fmi2GetDirectionalDerivative", knowns[j]);
            if (unknowns[k] == DER_X) result[k] += i->now.active * seed[j];
            if (unknowns[k] == W) result[k] += (MUTANT(directional_wrong) ? 2.0 : i->feedthrough) * seed[j];
        }
    }
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    Instance *i = c;
    for (size_t k = 0; k < n; ++k) {
        if (r[k] != U) return unknown(i, "fmi2SetRealInputDerivatives", r[k]);
        if (order[k] < 1 && !MUTANT(zeroth_derivative_accepted)) {
            return report(i, fmi2Error, "there is no derivative of order %d", order[k]);
        }
        if (order[k] == 1 && !MUTANT(input_slope_ignored)) i->now.slope = value[k];
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    Instance *i = c;
    double sign = i->now.sign == MINUS ? -1.0 : 1.0;
    for (size_t k = 0; k < n; ++k) {
        if (order[k] < 1) return report(i, fmi2Error, "there is no derivative of order %d", order[k]);
        if (r[k] == Y) value[k] = sign * i->now.real[G] * slope(&i->now);
        else if (r[k] == W) value[k] = slope(&i->now);
        else return unknown(i, "fmi2GetRealOutputDerivatives", r[k]);
        if (MUTANT(output_slope_wrong)) value[k] = 100.0;
        if (order[k] > 1) value[k] = 0.0;
    }
    return fmi2OK;
}

/* ---- steps ---- */

/* x after h seconds under u + slope s, exactly. */
static double solved(const State *s, double h)
{
    if (!s->active) return s->real[X];
    double k = s->real[K], decay = exp(-k * h), gain = -expm1(-k * h) / k;
    return s->real[X] * decay + s->real[U] * gain + s->slope * (h - gain) / k;
}

static fmi2Status checked(Instance *i, double time, double h)
{
    State *s = &i->now;
    double slack = MUTANT(rounding_not_expected) ? 0.0 : 1e-6 * h;
    double late = s->stop_defined ? time + h - s->stop : -h;
    if (!(h > 0.0) && !(MUTANT(negative_step_accepted) && h <= 0.0)) {
        return report(i, fmi2Error, "%g is no step size", h);
    }
    if (isinf(h)) {
        if (MUTANT(infinite_step_tried)) while (s->real[TIME] < h) s->real[TIME] += 0.001;
        return report(i, fmi2Error, "the step is infinite");
    }
    if (fabs(time - s->real[TIME]) > slack && !MUTANT(start_time_ignored) && h > 0.0) {
        return report(i, fmi2Error, "the FMU stands at %g, not at %g", s->real[TIME], time);
    }
    if (MUTANT(stop_time_excluded) ? late >= 0.0 : late > slack) {
        if (MUTANT(stop_time_discarded)) return report(i, fmi2Discard, "past stopTime");
        return report(i, fmi2Error, "past stopTime");
    }
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean final)
{
    Instance *i = c;
    State *s = MUTANT(shared_state) && shared ? shared : &i->now;
    if (expect(i, i->now.mode == STEPPING, "fmi2DoStep")) return fmi2Error;
    fmi2Status status = checked(i, time, h);
    if (status != fmi2OK) return status;
    if (MUTANT(other_size_refused) && i->now.steps > i->now.first && fabs(h - i->now.last_size) > 1e-9) {
        return report(i, fmi2Discard, "another step size");
    }
    if (MUTANT(prints_to_output)) {
        printf("stepping by %g\n", h);
        fflush(stdout);
    }
    if (h > 20.0) {
        s->mode = FAILED;
        return report(i, fmi2Discard, "the step is too large");
    }
    if (MUTANT(step_crashes)) abort();
    if (MUTANT(hangs)) for (;;) sleep(1);
    double size = MUTANT(step_size_ignored) ? 0.01 : h;
    s->real[X] = solved(s, size);
    s->real[U] += MUTANT(input_forgotten) ? 0.1 : s->slope * size;
    s->real[TIME] = time + h;
    i->now.last_size = h;
    ++s->steps;
    if (MUTANT(parameter_drifts)) s->real[K] += 1e-6;
    if (MUTANT(noise)) s->real[X] += 1e-12 * (double)(++counter);
    if (MUTANT(flushing_matters) && final) s->real[X] += 1e-9;
    if (MUTANT(pending_returned)) return fmi2Pending;
    return report(i, fmi2OK, "stepped to %g", s->real[TIME]);
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return report(c, fmi2Error, "there is no step to cancel");
}

static fmi2Status no_status(Instance *i)
{
    if (MUTANT(status_is_an_error)) return report(i, fmi2Error, "there is no such status");
    return report(i, fmi2Discard, "there is no such status");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind;
    (void)value;
    return no_status(c);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    Instance *i = c;
    if (kind != fmi2LastSuccessfulTime || MUTANT(status_is_an_error)) return no_status(c);
    if (MUTANT(status_after_discard_only) && i->now.mode != FAILED) return report(i, fmi2Error, "nothing was discarded");
    *value = i->now.real[TIME] - (MUTANT(last_time_wrong) ? i->now.last_size : 0.0);
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)kind;
    (void)value;
    return no_status(c);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (kind != fmi2Terminated) return no_status(c);
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)kind;
    (void)value;
    return no_status(c);
}

/* ---- model exchange ---- */

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    Instance *i = c;
    if (MUTANT(event_mode_refused)) return fmi2Error;
    if (expect(i, i->now.mode == CONTINUOUS, "fmi2EnterEventMode")) return fmi2Error;
    i->now.mode = EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    Instance *i = c;
    memset(info, 0, sizeof *info);
    if (expect(i, i->now.mode == EVENT, "fmi2NewDiscreteStates")) return fmi2Error;
    if (MUTANT(iteration_endless)) info->newDiscreteStatesNeeded = fmi2True;
    info->nextEventTimeDefined = fmi2True;
    info->nextEventTime = 0.25 * (floor(i->now.real[TIME] / 0.25 + 1e-9) + (MUTANT(event_in_the_past) ? 0.0 : 1.0));
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    Instance *i = c;
    if (MUTANT(exchange_order_unchecked) && i->now.mode == CONTINUOUS) return fmi2OK;
    if (expect(i, i->now.mode == EVENT, "fmi2EnterContinuousTimeMode")) return fmi2Error;
    i->now.mode = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean final, fmi2Boolean *event,
                                       fmi2Boolean *terminate)
{
    Instance *i = c;
    (void)final;
    *event = *terminate = fmi2False;
    if (expect(i, i->now.mode == CONTINUOUS, "fmi2CompletedIntegratorStep")) return fmi2Error;
    if (MUTANT(completed_step_moves)) i->now.real[X] += 1e-9;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    Instance *i = c;
    if (expect(i, in_exchange(i), "fmi2SetTime")) return fmi2Error;
    i->now.real[TIME] = time;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    Instance *i = c;
    if (n != 1 || expect(i, i->now.mode == CONTINUOUS, "fmi2SetContinuousStates")) return fmi2Error;
    if (!MUTANT(states_ignored)) i->now.real[X] = x[0];
    return fmi2OK;
}

static int solvable(const Instance *i, size_t given, size_t wanted)
{
    return i->now.exchange && i->now.mode != INSTANTIATED && given == wanted;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    Instance *i = c;
    if (expect(i, solvable(i, n, 1), "fmi2GetContinuousStates")) return fmi2Error;
    x[0] = i->now.real[X];
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t n)
{
    Instance *i = c;
    if (expect(i, solvable(i, n, 1), "fmi2GetDerivatives")) return fmi2Error;
    derivatives[0] = slope(&i->now);
    if (MUTANT(derivative_other_than_variable)) derivatives[0] *= 2.0;
    if (MUTANT(derivative_remembers)) derivatives[0] += 1e-9 * (double)(++counter);
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t n)
{
    Instance *i = c;
    int allowed = i->now.exchange && n == 1;
    if (expect(i, allowed, "fmi2GetNominalsOfContinuousStates")) return fmi2Error;
    nominals[0] = MUTANT(nominal_is_zero) ? 0.0 : 1.0;
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n)
{
    Instance *i = c;
    (void)indicators;
    if (expect(i, solvable(i, n, 0), "fmi2GetEventIndicators")) return fmi2Error;
    return fmi2OK;
}
