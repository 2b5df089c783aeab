/* Calls of the FMUs: values read and set, states saved and restored. */

static int refused(Loop *loop, int status, const char *function) {
    loop->status = status;
    loop->function = function;
    return REFUSED;
}

static int call_reads(Loop *loop, const Slave *slave) {
    for (int k = 0; k < slave->n_reads; k++) {
        const Call *call = &slave->reads[k];
        *slave->note = call->note;
        int status = call->plain
            ? call->plain(slave->component, call->references, call->count, call->values)
            : call->ranked(slave->component, call->references, call->count, call->orders, call->values);
        if (status > WARNING)
            return refused(loop, status, call->plain ? "fmi2GetReal" : "fmi2GetRealOutputDerivatives");
    }
    return DONE;
}

static int call_writes(Loop *loop, const Slave *slave, const Call *calls, int count) {
    for (int k = 0; k < count; k++) {
        const Call *call = &calls[k];
        if (call->places) {
            for (size_t i = 0; i < call->count; i++) call->values[i] = loop->C[call->places[i]];
            if (call->factors)
                for (size_t i = 0; i < call->count; i++)
                    call->values[i] = call->values[i] * call->factors[i] + call->offsets[i];
        }
        *slave->note = call->note;
        int status = call->plain
            ? call->plain(slave->component, call->references, call->count, call->values)
            : call->ranked(slave->component, call->references, call->count, call->orders, call->values);
        if (status > WARNING)
            return refused(loop, status, call->plain ? "fmi2SetReal" : "fmi2SetRealInputDerivatives");
    }
    return DONE;
}

static int save(Loop *loop) {
    for (int m = 0; m < loop->n_slaves; m++) {
        const Slave *slave = &loop->slaves[m];
        loop->which = m;
        if (*slave->states[loop->level]) {
            *slave->note = slave->free_note;
            slave->free_state(slave->component, slave->states[loop->level]);
            loop->calls++;
        }
        *slave->states[loop->level] = NULL;
        loop->calls++;
        *slave->note = slave->get_note;
        const int status = slave->get_state(slave->component, slave->states[loop->level]);
        if (status > WARNING) return refused(loop, status, "fmi2GetFMUstate");
    }
    return DONE;
}

static int restore(Loop *loop) {
    for (int m = 0; m < loop->n_slaves; m++) {
        const Slave *slave = &loop->slaves[m];
        loop->which = m;
        loop->calls++;
        *slave->note = slave->set_note;
        const int status = slave->set_state(slave->component, *slave->states[loop->level]);
        if (status > WARNING) return refused(loop, status, "fmi2SetFMUstate");
    }
    return DONE;
}
