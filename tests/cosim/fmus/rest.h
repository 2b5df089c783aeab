/* The state of an FMU whose whole state is its Model, and the rest of the interface, which the
   small FMUs of the tests do not need. */
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!*state) *state = malloc(sizeof(Model));
    memcpy(*state, c, sizeof(Model));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    memcpy(c, state, sizeof(Model));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    free(*state);
    *state = NULL;
    return fmi2OK;
}

#define UNUSED(name, ...) \
    fmi2Status name(fmi2Component c, __VA_ARGS__) { return fmi2Error; }
#define NOTHING(name) \
    fmi2Status name(fmi2Component c) { return fmi2OK; }

NOTHING(fmi2EnterInitializationMode)
NOTHING(fmi2ExitInitializationMode)
NOTHING(fmi2CancelStep)
UNUSED(fmi2SetDebugLogging, fmi2Boolean on, size_t n, const fmi2String names[])
UNUSED(fmi2GetString, const fmi2ValueReference r[], size_t n, fmi2String v[])
UNUSED(fmi2SetString, const fmi2ValueReference r[], size_t n, const fmi2String v[])
UNUSED(fmi2SerializedFMUstateSize, fmi2FMUstate s, size_t *n)
UNUSED(fmi2SerializeFMUstate, fmi2FMUstate s, fmi2Byte b[], size_t n)
UNUSED(fmi2DeSerializeFMUstate, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
UNUSED(fmi2GetDirectionalDerivative, const fmi2ValueReference a[], size_t n,
       const fmi2ValueReference b[], size_t m, const fmi2Real v[], fmi2Real w[])
UNUSED(fmi2GetStatus, const fmi2StatusKind k, fmi2Status *v)
UNUSED(fmi2GetRealStatus, const fmi2StatusKind k, fmi2Real *v)
UNUSED(fmi2GetIntegerStatus, const fmi2StatusKind k, fmi2Integer *v)
UNUSED(fmi2GetStringStatus, const fmi2StatusKind k, fmi2String *v)
#ifndef HAS_DISCRETE
UNUSED(fmi2GetInteger, const fmi2ValueReference r[], size_t n, fmi2Integer v[])
UNUSED(fmi2GetBoolean, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
UNUSED(fmi2SetInteger, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
UNUSED(fmi2SetBoolean, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
#endif
