/* The functions of FMI 2.0 model exchange: states, their derivatives, and the time events at which
   profiles or their slopes jump.

   The smooth piece of the profiles changes in event mode alone, so that a solver that ends a step at
   the time of an event sees the limit from the left there. */

#include <math.h>
#include <string.h>

#include "block.h"

/* The importer's time of an event may differ from it by rounding of this size. */
#define EVENT_ROUNDING 1e-12

static fmi2Status count_is_wrong(const struct instance *in, const char *function, size_t given,
                                 int count)
{
    report(in, fmi2Error, "%s was called for %lu values; this model has %d", function,
           (unsigned long)given, count);
    return fmi2Error;
}

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    struct instance *in = c;
    if (mode_of(in) != CONTINUOUS) return illegal(in, "fmi2EnterEventMode");
    in->state[MODE] = EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    struct instance *in = c;
    struct reason why;
    memset(info, 0, sizeof *info);
    if (mode_of(in) != EVENT) return illegal(in, "fmi2NewDiscreteStates");
    if (PROFILES == 0) return fmi2OK;
    double t = in->state[TIME];
    bool found = theta_at(in, t, &why);
    if (found && in->smooth.end - t <= EVENT_ROUNDING * greater(1.0, fabs(t))) {
        t = in->smooth.end;
        found = theta_at(in, t, &why);
    }
    if (!found) {
        report(in, fmi2Error, "the profiles cannot be evaluated at t = %.9g: %s", t, why.text);
        return fmi2Error;
    }
    in->state[EVENT_TIME] = t;
    forget_computed(in);
    info->nextEventTimeDefined = in->smooth.end < INFINITY;
    info->nextEventTime = info->nextEventTimeDefined ? in->smooth.end : 0.0;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    struct instance *in = c;
    if (mode_of(in) != EVENT) return illegal(in, "fmi2EnterContinuousTimeMode");
    in->state[MODE] = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state,
                                       fmi2Boolean *enter_event_mode, fmi2Boolean *terminate)
{
    struct instance *in = c;
    (void)no_set_state;
    *enter_event_mode = *terminate = fmi2False;
    return mode_of(in) == CONTINUOUS ? fmi2OK : illegal(in, "fmi2CompletedIntegratorStep");
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    struct instance *in = c;
    char text[32];
    if (mode_of(in) != EVENT && mode_of(in) != CONTINUOUS) return illegal(in, "fmi2SetTime");
    if (!isfinite(time)) {
        report(in, fmi2Error, "time = %s is refused: it must be finite", repr_of(time, text));
        return fmi2Error;
    }
    in->state[TIME] = time;
    forget_computed(in);
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t count)
{
    struct instance *in = c;
    char text[32];
    if (mode_of(in) != CONTINUOUS) return illegal(in, "fmi2SetContinuousStates");
    if (count != (size_t)STATES)
        return count_is_wrong(in, "fmi2SetContinuousStates", count, STATES);
    for (int i = 0; i < STATES; i++)
        if (!isfinite(x[i])) {
            report(in, fmi2Error, "%s = %s is refused: it must be finite",
                   VARIABLES[STATE_REFERENCES[i]].name, repr_of(x[i], text));
            return fmi2Error;
        }
    for (int i = 0; i < STATES; i++) in->x[i] = x[i];
    forget_computed(in);
    return fmi2OK;
}

/* Whether the values of an initialised model exchange, or one being initialised, can be read. */
static fmi2Status readable(struct instance *in, const char *function, size_t given, int count)
{
    if (!exchanges(in) || mode_of(in) == INSTANTIATED) return illegal(in, function);
    if (given != (size_t)count) return count_is_wrong(in, function, given, count);
    if (in->settled || settle(in)) return fmi2OK;
    report(in, fmi2Error, "%s", in->parameter_fault.text);
    return fmi2Error;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t count)
{
    struct instance *in = c;
    fmi2Status status = readable(in, "fmi2GetDerivatives", count, STATES);
    if (status != fmi2OK) return status;
    if (!computed_rates(in)) return fmi2Error;
    for (int i = 0; i < STATES; i++) derivatives[i] = in->rates[i];
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t count)
{
    struct instance *in = c;
    fmi2Status status = readable(in, "fmi2GetContinuousStates", count, STATES);
    for (int i = 0; status == fmi2OK && i < STATES; i++) x[i] = in->x[i];
    return status;
}

/* As modelDescription.xml gives none, all are 1. */
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t count)
{
    struct instance *in = c;
    if (!exchanges(in)) return illegal(in, "fmi2GetNominalsOfContinuousStates");
    if (count != (size_t)STATES)
        return count_is_wrong(in, "fmi2GetNominalsOfContinuousStates", count, STATES);
    for (int i = 0; i < STATES; i++) nominals[i] = 1.0;
    return fmi2OK;
}

/* What the FMU itself switches on are times. */
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t count)
{
    (void)indicators;
    return readable(c, "fmi2GetEventIndicators", count, 0);
}
