/* Values of variables: inputs over a step, theta, and what follows from the states. */

#include <math.h>
#include <string.h>

#include "block.h"

/* To be called whenever time, the states, an input or a parameter changes. */
void forget_computed(struct instance *in)
{
    in->values_known = in->outputs_known = in->derivatives_known = in->rates_known = false;
}

void forget_inputs(struct instance *in)
{
    in->cubics_known = false;
    forget_computed(in);
}

/* Find the smooth piece of all profiles at t. */
bool theta_at(struct instance *in, double t, struct reason *why)
{
    struct smooth *smooth = &in->smooth;
    if (smooth->known && smooth->start <= t && t < smooth->end) return true;
    smooth->known = false;
    for (int k = 0; k < REMEMBERED; k++) smooth->times[k] = NAN;
    smooth->start = -INFINITY;
    smooth->end = INFINITY;
    for (int j = 0; j < PROFILES; j++) {
        double start, end;
        if (!profile_segment(in->profiles + j, t, &start, &end, why)) return false;
        smooth->start = greater(smooth->start, start);
        smooth->end = lesser(smooth->end, end);
    }
    smooth->known = true;
    return true;
}

/* The place of a time: its bits times 2^64 over the golden ratio, of which the first ones depend on
   all of them (D. E. Knuth, The Art of Computer Programming, vol. 3, section 6.4). */
static int place_of(double t)
{
    uint64_t bits;
    memcpy(&bits, &t, sizeof bits);
    return (int)((bits * UINT64_C(0x9E3779B97F4A7C15)) >> 32) & (REMEMBERED - 1);
}

/* theta(t), or the signals and time, on the piece last found. */
void theta_values(struct instance *in, double t)
{
    if (PROFILES) {
        const double *dtheta = in->inputs + 4 * INPUTS;
        struct smooth *smooth = &in->smooth;
        int place = place_of(t);
        double *values = smooth->values + place * PROFILES;
        if (t != smooth->times[place])
            for (int j = 0; j < PROFILES; j++) values[j] = profile_value(in->profiles + j, t);
        smooth->times[place] = t;
        for (int j = 0; j < PROFILES; j++)
            in->theta[j] = TIMED ? values[j] : values[j] + dtheta[j];
    }
    if (TIMED) in->theta[PROFILES] = t;
}

/* Coefficients of each input over the step: v, der(v), der(v,2)/2, der(v,3)/6. */
void input_cubics(struct instance *in)
{
    const double *v = in->inputs;
    if (in->cubics_known) return;
    in->cubics_known = true;
    for (int i = 0; i < INPUTS; i++) {
        double *c = in->cubics + 4 * i;
        c[0] = v[i];
        c[1] = v[INPUTS + i];
        c[2] = v[2 * INPUTS + i] / 2.0;
        c[3] = v[3 * INPUTS + i] / 6.0;
    }
}

/* Whether all values of a role are finite; those that are not are reported. */
static bool are_finite(struct instance *in, enum role role, const double *values, int count)
{
    int faults = 0;
    for (int i = 0; i < count; i++) faults |= !isfinite(values[i]);
    if (!faults) return true;
    for (int vr = 0; vr < VARIABLE_COUNT; vr++) {
        const struct variable *variable = VARIABLES + vr;
        if (variable->role != role || variable->index >= count
            || isfinite(values[variable->index]))
            continue;
        report(in, fmi2Error,
               "%s left the range of floating-point numbers at t = %.9g; %s", variable->name,
               in->state[TIME],
               in->state[MODE] < STEPPING
                   ? "take less extreme parameters, start values or inputs"
                   : "the loop diverges: take a smaller communication step, or less extreme "
                     "parameters and inputs");
    }
    return false;
}

/* theta, the inputs and, on demand, slopes of both at the instance's time: what the equations take.
   Inputs of model exchange are values at all times, so that SINCE is 0. */
bool values_now(struct instance *in, bool slopes, struct reason *why)
{
    double t = in->state[TIME], s = in->state[SINCE];
    /* Equations without time take no slopes of signals. */
    if (in->values_known && !(slopes && (TIMED || DELAYED))) return true;
    if (PROFILES) {
        if (!theta_at(in, exchanges(in) ? in->state[EVENT_TIME] : t, why)) return false;
        theta_values(in, t);
        for (int j = 0; TIMED && slopes && j < PROFILES; j++)
            in->theta[PROFILES + 1 + j] = profile_derivative(in->profiles + j, t);
    }
    if (DELAYED) delayed_values(in, slopes);
    if (s != 0.0) input_cubics(in);
    for (int i = 0; i < INPUTS; i++) {
        const double *c = in->cubics + 4 * i;
        in->v[i] = s == 0.0 ? in->inputs[i] : c[0] + s * (c[1] + s * (c[2] + s * c[3]));
        in->slopes[i] =
            s == 0.0 ? in->inputs[INPUTS + i] : c[1] + s * (2.0 * c[2] + s * 3.0 * c[3]);
    }
    return in->values_known = true;
}

static bool evaluate(struct instance *in, enum role role)
{
    struct reason why;
    if (!values_now(in, role == DERIVATIVE, &why)) {
        report(in, fmi2Error, "the outputs cannot be evaluated at t = %.9g: %s", in->state[TIME],
               why.text);
        return false;
    }
    switch (role) {
    case OUTPUT:
        model_outputs(in->bound, in->x, in->v, in->theta, in->outputs);
        return in->outputs_known = are_finite(in, OUTPUT, in->outputs, OUTPUTS);
    case DERIVATIVE:
        model_derivatives(in->bound, in->x, in->v, in->slopes, in->theta, in->derivatives);
        return in->derivatives_known = are_finite(in, DERIVATIVE, in->derivatives, DERIVATIVES);
    case RATE:
        model_rates(in->bound, in->x, in->v, in->theta, in->rates);
        return in->rates_known = are_finite(in, RATE, in->rates, STATES);
    default: return true;
    }
}

bool computed_rates(struct instance *in) { return in->rates_known || evaluate(in, RATE); }

/* The value of a Real variable; false where it cannot be computed, which is then logged. */
bool computed_value(struct instance *in, const struct variable *variable, double *value)
{
    int i = variable->index;
    switch (variable->role) {
    case INPUT: *value = in->inputs[i]; return true;
    case CONSTANT: *value = in->constants[i]; return true;
    default: break;
    }
    if (!in->settled && !settle(in)) {
        report(in, fmi2Error, "%s", in->parameter_fault.text);
        return false;
    }
    switch (variable->role) {
    case OUTPUT:
        if (!in->outputs_known && !evaluate(in, OUTPUT)) return false;
        *value = in->outputs[i];
        return true;
    case DERIVATIVE:
        if (!in->derivatives_known && !evaluate(in, DERIVATIVE)) return false;
        *value = in->derivatives[i];
        return true;
    case RATE:
        if (!computed_rates(in)) return false;
        *value = in->rates[i];
        return true;
    case GAIN: *value = in->gains[i]; return true;
    default:
        if (!evaluate(in, variable->role)) return false;
        *value = variable->role == THETA ? in->theta[i]
                 : DELAYED               ? delayed_event(in)
                                         : in->smooth.end;
        return true;
    }
}
