/* The names that the files of one FMU share, with a prefix.

   Without one, a name could be that of a function of the C library (glibc has an `advance`), and the
   sources of two FMUs could not be linked into one program. FMI2_FUNCTION_PREFIX is what FMI 2.0
   puts before its own functions there. */

#ifndef CONGELATION_NAMES_H
#define CONGELATION_NAMES_H

#ifdef FMI2_FUNCTION_PREFIX
#define CONGELATION_PREFIX FMI2_FUNCTION_PREFIX
#else
#define CONGELATION_PREFIX congelation_
#endif
#define CONGELATION_JOIN(a, b) a##b
#define CONGELATION_JOIN_VALUES(a, b) CONGELATION_JOIN(a, b)
#define OWN(name) CONGELATION_JOIN_VALUES(CONGELATION_PREFIX, name)

/* FMPy's copy of the headers leaves the prefix out. */
#ifdef FMI2_FUNCTION_PREFIX
#undef fmi2FullName
#define fmi2FullName(name) OWN(name)
#endif

/* the generated model */
#define MODEL_GUID OWN(MODEL_GUID)
#define MODEL_KEY OWN(MODEL_KEY)
#define VARIABLE_COUNT OWN(VARIABLE_COUNT)
#define STATES OWN(STATES)
#define INPUTS OWN(INPUTS)
#define OUTPUTS OWN(OUTPUTS)
#define DERIVATIVES OWN(DERIVATIVES)
#define GAINS OWN(GAINS)
#define PROFILES OWN(PROFILES)
#define CONSTANTS OWN(CONSTANTS)
#define PARAMETERS OWN(PARAMETERS)
#define LEAVE_AT_JUMPS OWN(LEAVE_AT_JUMPS)
#define DELAYED OWN(DELAYED)
#define DELAY OWN(DELAY)
#define BEFORE OWN(BEFORE)
#define CAPACITY OWN(CAPACITY)
#define TIMED OWN(TIMED)
#define VARIABLES OWN(VARIABLES)
#define MODEL_PARAMETERS OWN(MODEL_PARAMETERS)
#define START_CONSTANTS OWN(START_CONSTANTS)
#define OUTPUT_OF_DERIVATIVE OWN(OUTPUT_OF_DERIVATIVE)
#define STATE_REFERENCES OWN(STATE_REFERENCES)
#define PROFILE_SLOTS OWN(PROFILE_SLOTS)
#define BOUND_SIZE OWN(BOUND_SIZE)
#define model_gains OWN(model_gains)
#define model_bind OWN(model_bind)
#define model_rates OWN(model_rates)
#define model_outputs OWN(model_outputs)
#define model_derivatives OWN(model_derivatives)
#define model_tangents OWN(model_tangents)

/* gains.c, exact.c */
#define rule_iss_filter_gain OWN(rule_iss_filter_gain)
#define rule_hurwitz_filter_gain OWN(rule_hurwitz_filter_gain)
#define rule_filter_norm OWN(rule_filter_norm)
#define rule_matched_riccati OWN(rule_matched_riccati)
#define is_positive_definite OWN(is_positive_definite)
#define exact_sum OWN(exact_sum)
#define exact_of OWN(exact_of)
#define exact_rounded OWN(exact_rounded)
#define exact_add OWN(exact_add)
#define exact_subtract OWN(exact_subtract)
#define exact_multiply OWN(exact_multiply)
#define exact_divide OWN(exact_divide)

/* profiles.c, table.c, delay.c, log.c, parameters.c, variables.c, integrator.c, state.c */
#define profile_bind OWN(profile_bind)
#define profile_segment OWN(profile_segment)
#define profile_value OWN(profile_value)
#define profile_derivative OWN(profile_derivative)
#define table_read OWN(table_read)
#define table_free OWN(table_free)
#define table_piece OWN(table_piece)
#define ring_open OWN(ring_open)
#define ring_copy OWN(ring_copy)
#define ring_set OWN(ring_set)
#define delayed_values OWN(delayed_values)
#define delayed_event OWN(delayed_event)
#define delayed_step OWN(delayed_step)
#define report OWN(report)
#define illegal OWN(illegal)
#define explain OWN(explain)
#define repr_of OWN(repr_of)
#define settle OWN(settle)
#define theta_at OWN(theta_at)
#define theta_values OWN(theta_values)
#define input_cubics OWN(input_cubics)
#define values_now OWN(values_now)
#define computed_value OWN(computed_value)
#define computed_rates OWN(computed_rates)
#define forget_computed OWN(forget_computed)
#define forget_inputs OWN(forget_inputs)
#define advance OWN(advance)
#define serialized_size OWN(serialized_size)
#define serialize OWN(serialize)
#define deserialize OWN(deserialize)

#endif
