/* The functions that FMI 2.0 has for both kinds and for co-simulation, and the state machine behind
   them; those of model exchange are in exchange.c.

   A refused call returns fmi2Error, with its reason logged, and changes nothing. A step that
   cannot be taken returns fmi2Discard and leaves the states where they were. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "block.h"

/* Relative tolerance of the internal integration where fmi2SetupExperiment gives none. */
#define DEFAULT_TOLERANCE 1e-8
/* A communication point may differ from the instance's own time by rounding of this size. */
#define TIME_ROUNDING 1e-9
/* First internal step tried, in seconds; the step control takes it from there. */
#define FIRST_STEP 1e-3

static fmi2Status unsupported(const struct instance *in, const char *what)
{
    report(in, fmi2Error, "%s", what);
    return fmi2Error;
}

/* -- life ------------------------------------------------------------------------------------- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

static void set_defaults(struct instance *in)
{
    double kind = in->state[KIND];
    memset(in->state, 0, state_size());
    in->state[KIND] = kind;
    for (int j = 0; j < PROFILES; j++)
        strncpy(in->files + j * FILE_SIZE, PROFILE_SLOTS[j].start_file, FILE_SIZE - 1);
    in->state[TOLERANCE] = DEFAULT_TOLERANCE;
    in->state[INNER_STEP] = FIRST_STEP;
    for (int vr = 0; vr < VARIABLE_COUNT; vr++)
        if (VARIABLES[vr].role == CONSTANT) in->constants[VARIABLES[vr].index] = VARIABLES[vr].start;
    in->settled = false;
    in->smooth.known = false;
    forget_inputs(in);
    settle(in);
}

/* Terms with events, and sines: a chirp of one frequency is a sine. */
static int event_room(const struct profile_slots *s)
{
    return s->squares + s->chirps + s->telegraphs + s->noises;
}

/* All memory of an instance in one piece, so that nothing is allocated later. Called first to
   measure, with no memory, and then to share it out. */
static size_t share_out(struct instance *in, char *memory)
{
    size_t used = (sizeof(struct instance) + 15u) & ~(size_t)15u;
#define TAKE(pointer, type, count)                                          \
    do {                                                                    \
        if (memory) pointer = (type *)(void *)(memory + used);              \
        used += ((size_t)(count) * sizeof(type) + 15u) & ~(size_t)15u;      \
    } while (0)
    TAKE(in->state, double, state_size() / sizeof(double)); /* FILE_SIZE is a multiple of it */
    if (memory) {
        in->files = (char *)(in->state + state_length());
        in->x = in->state + SCALARS;
        in->inputs = in->x + STATES;
        in->constants = in->inputs + 4 * INPUTS + (TIMED ? 0 : PROFILES);
    }
    TAKE(in->gains, double, GAINS);
    TAKE(in->candidate_gains, double, GAINS);
    TAKE(in->bound, double, BOUND_SIZE / sizeof(double) + 1);
    TAKE(in->outputs, double, OUTPUTS);
    TAKE(in->derivatives, double, DERIVATIVES);
    TAKE(in->rates, double, STATES);
    TAKE(in->k, double, 7 * STATES);
    TAKE(in->y, double, STATES);
    TAKE(in->point, double, STATES);
    TAKE(in->old_x, double, STATES);
    TAKE(in->v, double, INPUTS);
    TAKE(in->slopes, double, INPUTS);
    TAKE(in->theta, double, 2 * signals() + 1);
    TAKE(in->smooth.values, double, REMEMBERED * PROFILES);
    TAKE(in->cubics, double, 4 * INPUTS);
    TAKE(in->seeds, double, STATES + 2 * INPUTS + 2 * signals() + 1);
    TAKE(in->tangents, double, STATES + OUTPUTS + DERIVATIVES);
    TAKE(in->profiles, struct profile, PROFILES);
    for (int j = 0; j < PROFILES; j++) {
        const struct profile_slots *slots = PROFILE_SLOTS + j;
        struct profile unused, *profile = memory ? in->profiles + j : &unused;
        TAKE(profile->sines, sine, slots->sines + slots->chirps);
        TAKE(profile->terms, struct term, event_room(slots));
        TAKE(profile->pieces, struct piece, event_room(slots));
    }
#undef TAKE
    return used;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging)
{
    (void)resources; /* nothing is read from there, so any form of URI will do */
    (void)visible;
    if (!functions || !functions->logger) return NULL;
    double kind[SCALARS] = {0.0};
    struct instance asking = {0};
    asking.state = kind;
    asking.callbacks = functions;
    asking.name = (char *)(name && *name ? name : "(no name)");
    if (!name || !*name) {
        unsupported(&asking, "fmi2Instantiate: instanceName is empty; give the instance a name");
        return NULL;
    }
    if (!guid || strcmp(guid, MODEL_GUID) != 0) {
        report(&asking, fmi2Error,
               "fmi2Instantiate: the GUID is %s, but the library was built for %s; take both from "
               "one FMU",
               guid ? guid : "missing", MODEL_GUID);
        return NULL;
    }
    if (type == fmi2ModelExchange && DELAYED) {
        unsupported(&asking, "fmi2Instantiate: a delay is for co-simulation alone, as model exchange "
                             "does not say what an input is between two times");
        return NULL;
    }
    if (type != fmi2CoSimulation && type != fmi2ModelExchange) {
        unsupported(&asking, "fmi2Instantiate: the type is neither fmi2CoSimulation nor "
                             "fmi2ModelExchange");
        return NULL;
    }
    char *memory = calloc(1, share_out(&asking, NULL));
    char *copy = malloc(strlen(name) + 1);
    if (!memory || !copy) {
        free(memory);
        free(copy);
        unsupported(&asking, "fmi2Instantiate: there is no memory left");
        return NULL;
    }
    struct instance *in = (struct instance *)(void *)memory;
    in->callbacks = functions;
    in->name = strcpy(copy, name);
    in->logging = logging != fmi2False;
    share_out(in, memory);
    in->state[KIND] = type;
    set_defaults(in);
    return in;
}

void fmi2FreeInstance(fmi2Component c)
{
    struct instance *in = c;
    if (!in) return;
    for (int j = 0; j < PROFILES; j++) table_free(&in->profiles[j].table);
    free(in->ring.pieces);
    free(in->name);
    free(in);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t count,
                               const fmi2String categories[])
{
    static const char *const known[] = {"logAll", "logStatusWarning", "logStatusDiscard",
                                        "logStatusError", "logStatusFatal", "logStatusPending"};
    struct instance *in = c;
    for (size_t i = 0; i < count; i++) {
        bool found = false;
        for (size_t k = 0; k < sizeof known / sizeof *known; k++)
            found = found || (categories[i] && strcmp(categories[i], known[k]) == 0);
        if (!found) {
            report(in, fmi2Error, "'%s' is no log category of this FMU",
                   categories[i] ? categories[i] : "");
            return fmi2Error;
        }
    }
    in->logging = on != fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
{
    struct instance *in = c;
    char text[32];
    if (mode_of(in) != INSTANTIATED) return illegal(in, "fmi2SetupExperiment");
    if (!isfinite(start) || (has_stop && !isfinite(stop))) {
        report(in, fmi2Error, "%s = %s is refused: it must be finite",
               isfinite(start) ? "stopTime" : "startTime",
               repr_of(isfinite(start) ? stop : start, text));
        return fmi2Error;
    }
    if (has_stop && stop < start) {
        report(in, fmi2Error, "stopTime = %s is before startTime", repr_of(stop, text));
        return fmi2Error;
    }
    if (has_tolerance && !(0.0 < tolerance && tolerance < 1.0)) {
        report(in, fmi2Error, "tolerance = %s is refused: 0 < tolerance < 1",
               repr_of(tolerance, text));
        return fmi2Error;
    }
    in->state[TIME] = in->state[EVENT_TIME] = start;
    in->state[HAS_STOP] = has_stop ? 1.0 : 0.0;
    in->state[STOP_TIME] = has_stop ? stop : 0.0;
    in->state[TOLERANCE] = has_tolerance ? tolerance : DEFAULT_TOLERANCE;
    forget_computed(in);
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    struct instance *in = c;
    if (mode_of(in) != INSTANTIATED) return illegal(in, "fmi2EnterInitializationMode");
    in->state[MODE] = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    struct instance *in = c;
    if (mode_of(in) != INITIALIZATION) return illegal(in, "fmi2ExitInitializationMode");
    if (!in->settled && !settle(in)) return unsupported(in, in->parameter_fault.text);
    in->state[MODE] = exchanges(in) ? EVENT : STEPPING;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    struct instance *in = c;
    if (mode_of(in) < STEPPING || mode_of(in) == TERMINATED) return illegal(in, "fmi2Terminate");
    in->state[MODE] = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    set_defaults(c);
    return fmi2OK;
}

/* -- values ----------------------------------------------------------------------------------- */

static const char *type_name(char type)
{
    return type == 'R' ? "Real" : type == 'I' ? "Integer" : type == 'B' ? "Boolean" : "String";
}

static const struct variable *of_type(const struct instance *in, fmi2ValueReference vr, char type)
{
    if (vr < (fmi2ValueReference)VARIABLE_COUNT && VARIABLES[vr].type == type)
        return VARIABLES + vr;
    report(in, fmi2Error, "value reference %u is no %s variable of this model", vr,
           type_name(type));
    return NULL;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                       fmi2Real value[])
{
    struct instance *in = c;
    fmi2Status status = fmi2OK;
    for (size_t i = 0; i < count; i++) {
        const struct variable *variable = of_type(in, vr[i], 'R');
        value[i] = 0.0;
        if (!variable || !computed_value(in, variable, value + i)) status = fmi2Error;
    }
    return status;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                          fmi2Integer value[])
{
    struct instance *in = c;
    for (size_t i = 0; i < count; i++) {
        const struct variable *variable = of_type(in, vr[i], 'I');
        if (!variable) return fmi2Error;
        value[i] = (fmi2Integer)in->constants[variable->index];
    }
    return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                          fmi2Boolean value[])
{
    struct instance *in = c;
    for (size_t i = 0; i < count; i++) {
        const struct variable *variable = of_type(in, vr[i], 'B');
        if (!variable) return fmi2Error;
        value[i] = in->constants[variable->index] != 0.0 ? fmi2True : fmi2False;
    }
    return fmi2OK;
}

/* The only strings are files of tables; the place of one. */
static char *file_of(const struct instance *in, const struct variable *variable)
{
    int j = 0;
    while (j + 1 < PROFILES && PROFILE_SLOTS[j].file != variable->index) j++;
    return in->files + j * FILE_SIZE;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                         fmi2String value[])
{
    struct instance *in = c;
    for (size_t i = 0; i < count; i++) {
        const struct variable *variable = of_type(in, vr[i], 'S');
        if (!variable) return fmi2Error;
        value[i] = file_of(in, variable);
    }
    return fmi2OK;
}

/* A constant that may be set now; NULL, with the reason logged, otherwise. */
static const struct variable *settable(const struct instance *in, fmi2ValueReference vr, char type)
{
    if (vr >= (fmi2ValueReference)VARIABLE_COUNT || VARIABLES[vr].type != type
        || VARIABLES[vr].role != CONSTANT) {
        report(in, fmi2Error, "value reference %u is no %s that can be set", vr, type_name(type));
        return NULL;
    }
    if (mode_of(in) > INITIALIZATION) {
        report(in, fmi2Error, "%s is fixed and cannot be set after initialization; reset the "
               "instance first",
               VARIABLES[vr].name);
        return NULL;
    }
    return VARIABLES + vr;
}

static void set_constant(struct instance *in, const struct variable *variable, double value)
{
    in->constants[variable->index] = value;
    in->settled = false;
    forget_computed(in);
}

/* Inputs that are set hold at the communication point; the step begins anew. */
static void set_input(struct instance *in, int slot, double value)
{
    in->inputs[slot] = value;
}

static void inputs_were_set(struct instance *in)
{
    in->state[SINCE] = 0.0;
    forget_inputs(in);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                       const fmi2Real value[])
{
    struct instance *in = c;
    char text[32];
    fmi2Status status = fmi2OK;
    for (size_t i = 0; i < count; i++) {
        bool known = vr[i] < (fmi2ValueReference)VARIABLE_COUNT;
        if (!isfinite(value[i])) {
            report(in, fmi2Error, "%s = %s is refused: it must be finite",
                   known ? VARIABLES[vr[i]].name : "an unknown variable", repr_of(value[i], text));
            status = fmi2Error;
        } else if (known && VARIABLES[vr[i]].role == INPUT) {
            if (mode_of(in) == TERMINATED) return illegal(in, "fmi2SetReal");
            set_input(in, VARIABLES[vr[i]].index, value[i]);
        } else {
            const struct variable *variable = settable(in, vr[i], 'R');
            if (variable) set_constant(in, variable, value[i]);
            else status = fmi2Error;
        }
    }
    inputs_were_set(in);
    return status;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                          const fmi2Integer value[])
{
    struct instance *in = c;
    for (size_t i = 0; i < count; i++) {
        const struct variable *variable = settable(in, vr[i], 'I');
        if (!variable) return fmi2Error;
        set_constant(in, variable, (double)value[i]);
    }
    return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                          const fmi2Boolean value[])
{
    struct instance *in = c;
    for (size_t i = 0; i < count; i++) {
        const struct variable *variable = settable(in, vr[i], 'B');
        if (!variable) return fmi2Error;
        set_constant(in, variable, value[i] ? 1.0 : 0.0);
    }
    return fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                         const fmi2String value[])
{
    struct instance *in = c;
    for (size_t i = 0; i < count; i++) {
        const struct variable *variable = settable(in, vr[i], 'S');
        if (!variable) return fmi2Error;
        if (!value[i] || strlen(value[i]) >= FILE_SIZE) {
            report(in, fmi2Error, "%s is refused: it must be a string of at most %d bytes",
                   variable->name, FILE_SIZE - 1);
            return fmi2Error;
        }
        strcpy(memset(file_of(in, variable), 0, FILE_SIZE), value[i]);
        in->settled = false;
        forget_computed(in);
    }
    return fmi2OK;
}

/* der(v), der(v,2) and der(v,3) are inputs too: this is another way to set them. */
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[],
                                       size_t count, const fmi2Integer order[],
                                       const fmi2Real value[])
{
    struct instance *in = c;
    char text[32];
    if (mode_of(in) == TERMINATED) return illegal(in, "fmi2SetRealInputDerivatives");
    for (size_t i = 0; i < count; i++) {
        const struct variable *variable = of_type(in, vr[i], 'R');
        if (!variable) return fmi2Error;
        if (variable->role != INPUT || variable->index >= INPUTS || order[i] < 1 || order[i] > 3) {
            report(in, fmi2Error,
                   "the derivative of order %d of %s cannot be set; valid: orders 1 to 3 of a "
                   "continuous input",
                   order[i], variable->name);
            return fmi2Error;
        }
        if (!isfinite(value[i])) {
            report(in, fmi2Error, "the derivative of order %d of %s = %s is refused: it must be "
                   "finite",
                   order[i], variable->name, repr_of(value[i], text));
            return fmi2Error;
        }
        set_input(in, order[i] * INPUTS + variable->index, value[i]);
    }
    inputs_were_set(in);
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[],
                                        size_t count, const fmi2Integer order[], fmi2Real value[])
{
    struct instance *in = c;
    for (size_t i = 0; i < count; i++) {
        const struct variable *variable = of_type(in, vr[i], 'R'), *derivative = NULL;
        if (!variable) return fmi2Error;
        for (int k = 0; k < VARIABLE_COUNT && order[i] == 1; k++)
            if (VARIABLES[k].role == DERIVATIVE && variable->role == OUTPUT
                && OUTPUT_OF_DERIVATIVE[VARIABLES[k].index] == variable->index)
                derivative = VARIABLES + k;
        if (!derivative) {
            report(in, fmi2Error,
                   "the derivative of order %d of %s is not known; valid: order 1 of an output v "
                   "that has an output der(v)",
                   order[i], variable->name);
            return fmi2Error;
        }
        if (!computed_value(in, derivative, value + i)) return fmi2Error;
    }
    return fmi2OK;
}

/* The seed of a known variable; NULL, with the reason logged, where the derivatives with respect to
   it are not known. `none` is for those that no equation takes at a communication point. */
static double *seed_of(const struct instance *in, fmi2ValueReference vr, double *none)
{
    double *x = in->seeds, *v = x + STATES, *d = v + INPUTS, *theta = d + INPUTS;
    const struct variable *variable = of_type(in, vr, 'R');
    if (!variable) return NULL;
    for (int i = 0; i < STATES; i++)
        if (STATE_REFERENCES[i] == vr
            || (variable->role == CONSTANT && mode_of(in) == INITIALIZATION
                && START_CONSTANTS[i] == variable->index))
            return x + i;
    if (variable->role == INPUT) {
        int slot = variable->index;
        return slot < INPUTS       ? v + slot
               : slot < 2 * INPUTS ? d + (slot - INPUTS)
               : slot < 4 * INPUTS ? none
                                   : theta + (slot - 4 * INPUTS);
    }
    report(in, fmi2Error,
           "derivatives with respect to %s are not known; valid: inputs, continuous states, and in "
           "initialization mode the start values of these",
           variable->name);
    return NULL;
}

/* Forward derivatives of the expression graphs, at what the instance was last set to. */
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[],
                                        size_t unknowns, const fmi2ValueReference known[],
                                        size_t knowns, const fmi2Real seed[], fmi2Real value[])
{
    struct instance *in = c;
    struct reason why;
    if (mode_of(in) == INSTANTIATED) return illegal(in, "fmi2GetDirectionalDerivative");
    if (!in->settled && !settle(in)) return unsupported(in, in->parameter_fault.text);
    if (!values_now(in, true, &why)) return unsupported(in, why.text);
    double *x = in->seeds, *v = x + STATES, *d = v + INPUTS, *theta = d + INPUTS, none;
    memset(x, 0, (size_t)(STATES + 2 * INPUTS + 2 * signals() + 1) * sizeof(double));
    for (size_t i = 0; i < knowns; i++) {
        double *place = seed_of(in, known[i], &none);
        if (!place) return fmi2Error;
        *place = seed[i];
    }
    double *rates = in->tangents, *outputs = rates + STATES, *derivatives = outputs + OUTPUTS;
    model_tangents(in->bound, in->x, in->v, in->slopes, in->theta, x, v, d, theta, in->tangents);
    for (size_t i = 0; i < unknowns; i++) {
        const struct variable *variable = of_type(in, unknown[i], 'R');
        if (!variable) return fmi2Error;
        switch (variable->role) {
        case RATE: value[i] = rates[variable->index]; break;
        case OUTPUT: value[i] = outputs[variable->index]; break;
        case DERIVATIVE: value[i] = derivatives[variable->index]; break;
        case THETA: value[i] = TIMED ? 0.0 : theta[variable->index]; break;
        case GAIN:
        case NEXT_EVENT: value[i] = 0.0; break; /* these follow from parameters and time */
        default:
            report(in, fmi2Error, "%s is set from outside: it has no derivatives", variable->name);
            return fmi2Error;
        }
        if (!isfinite(value[i])) {
            report(in, fmi2Error, "the derivative of %s is not finite at t = %.9g", variable->name,
                   in->state[TIME]);
            return fmi2Error;
        }
    }
    return fmi2OK;
}

/* -- stepping --------------------------------------------------------------------------------- */

static bool may_step(const struct instance *in, double t, double h, struct reason *why)
{
    double own = in->state[TIME], rounding = TIME_ROUNDING * greater(1.0, fabs(own));
    char text[32];
    if (!(0.0 < h && h < INFINITY)) {
        explain(why, "the step size must be positive and finite");
        return false;
    }
    if (!(fabs(t - own) <= rounding)) {
        explain(why, "this instance is at t = %s", repr_of(own, text));
        return false;
    }
    if (in->state[HAS_STOP] != 0.0 && t + h > in->state[STOP_TIME] + rounding) {
        explain(why, "it ends after the stop time %s", repr_of(in->state[STOP_TIME], text));
        return false;
    }
    return true;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_set_state)
{
    struct instance *in = c;
    struct reason why;
    size_t size = (size_t)STATES * sizeof(double);
    double old_step = in->state[INNER_STEP];
    (void)no_set_state;
    if (mode_of(in) != STEPPING) return illegal(in, "fmi2DoStep");
    if (!in->settled && !settle(in)) return unsupported(in, in->parameter_fault.text);
    if (!may_step(in, t, h, &why)) {
        report(in, fmi2Error, "the step from t = %.9g by %.9g is refused: %s", t, h, why.text);
        return fmi2Error;
    }
    memcpy(in->old_x, in->x, size);
    /* A step that is left early ends at the first jump inside of it; that at its very end belongs to
       the next one. What cannot be evaluated is told by the step itself. */
    double jump = t + h;
    bool leaves = LEAVE_AT_JUMPS >= 0 && in->constants[LEAVE_AT_JUMPS] != 0.0
                  && values_now(in, false, &why);
    double event = leaves && DELAYED ? delayed_event(in) : in->smooth.end;
    leaves = leaves && t < event && event - t < h;
    if (leaves) {
        jump = event;
        h = jump - t;
    }
    if (!advance(in, t, h, &why)) {
        memcpy(in->x, in->old_x, size);
        in->state[INNER_STEP] = old_step;
        forget_computed(in);
        report(in, fmi2Discard, "the step from t = %.9g by %.9g is discarded: %s", t, h, why.text);
        return fmi2Discard;
    }
    in->state[TIME] = jump;
    in->state[SINCE] = h;
    forget_computed(in);
    if (!leaves) return fmi2OK;
    report(in, fmi2Discard, "the step from t = %.9g ended at the jump at t = %.9g", t, jump);
    return fmi2Discard;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return unsupported(c, "fmi2CancelStep: no step runs in the background");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind, (void)value;
    return unsupported(c, "fmi2GetStatus: no step runs in the background");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    struct instance *in = c;
    if (kind != fmi2LastSuccessfulTime)
        return unsupported(c, "fmi2GetRealStatus: only fmi2LastSuccessfulTime is known");
    *value = in->state[TIME];
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)kind, (void)value;
    return unsupported(c, "fmi2GetIntegerStatus: FMI 2.0 defines no such status");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (kind != fmi2Terminated)
        return unsupported(c, "fmi2GetBooleanStatus: only fmi2Terminated is known");
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)kind, (void)value;
    return unsupported(c, "fmi2GetStringStatus: no step runs in the background");
}

/* -- state ------------------------------------------------------------------------------------ */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    struct instance *in = c;
    if (!in->settled) settle(in); /* so that x are the start values */
    /* A former state has its room but where a delay remembers more now. */
    double *room = *state;
    if (!room || saved_size(room) < saved_size(in->state)) room = realloc(room, saved_size(in->state));
    if (!room) return unsupported(in, "fmi2GetFMUstate: there is no memory left");
    *state = memcpy(room, in->state, state_size());
    if (DELAYED) ring_copy(in, pieces_of(room));
    return fmi2OK;
}

static bool are_same_files(const char *a, const char *b)
{
    for (int j = 0; j < PROFILES; j++)
        if (strcmp(a + j * FILE_SIZE, b + j * FILE_SIZE) != 0) return false;
    return true;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    struct instance *in = c;
    double *given = state;
    const double *constants;
    if (!state) return unsupported(in, "fmi2SetFMUstate: the state is NULL");
    if (given[KIND] != in->state[KIND])
        return unsupported(in, "fmi2SetFMUstate: the state is one of the other kind, co-simulation "
                               "or model exchange");
    constants = given + (in->constants - in->state);
    bool same = in->settled
                && memcmp(constants, in->constants, (size_t)CONSTANTS * sizeof(double)) == 0
                && are_same_files(files_of(given), in->files);
    memcpy(in->state, given, state_size());
    forget_inputs(in);
    if (!same) {
        /* Binding sets x to the start values, so the state is copied once more. Parameters that
           were refused before are refused again when they are needed. */
        in->settled = false;
        if (settle(in)) memcpy(in->state, given, state_size());
    }
    if (DELAYED) ring_set(in, pieces_of(given), in->settled ? (size_t)given[PIECES] : 0);
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    if (!state) return unsupported(c, "fmi2SerializedFMUstateSize: the state is NULL");
    *size = serialized_size(state);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (!state || size < serialized_size(state))
        return unsupported(c, "fmi2SerializeFMUstate: the state is NULL, or the size is less than "
                              "that of fmi2SerializedFMUstateSize");
    serialize(state, (unsigned char *)bytes);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate *state)
{
    struct instance *in = c;
    const char *fault = NULL;
    double *read = deserialize((const unsigned char *)bytes, size, &fault);
    if (!read) {
        report(in, fmi2Error, "the state is refused: %s", fault);
        return fmi2Error;
    }
    *state = read;
    return fmi2OK;
}
