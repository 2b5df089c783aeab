/* A minimal co-simulation host: loads the library of one FMU, runs it, prints its outputs.
 *
 *     host load LIBRARY ...
 *     host run LIBRARY GUID URI START STEP STEPS FILE [REFERENCE...]
 *
 * Writes one line for each step to FILE, with the Real variables of the given references as
 * hexadecimal floating-point numbers; standard output belongs to the FMU. Exit code 0: all calls succeeded; 1: one did not; 2: not loaded. */

#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef __linux__
#include <signal.h>
#include <sys/prctl.h>
#endif

#include "fmi2FunctionTypes.h"

static void *library;

static void *function(const char *name)
{
    void *found = dlsym(library, name);
    if (found == NULL) {
        fprintf(stderr, "%s is not exported\n", name);
        exit(2);
    }
    return found;
}

static void require(fmi2Status status, const char *call)
{
    if (status > fmi2Warning) {
        fprintf(stderr, "%s returned status %d\n", call, (int)status);
        exit(1);
    }
}

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...)
{
    (void)environment;
    (void)category;
    if (status > fmi2Warning) {
        va_list arguments;
        va_start(arguments, message);
        fprintf(stderr, "%s: ", instance);
        vfprintf(stderr, message, arguments);
        fputc('\n', stderr);
        va_end(arguments);
    }
}

static void run(char *words[], int count, FILE *results)
{
    const double start = atof(words[2]), size = atof(words[3]);
    const int steps = atoi(words[4]), outputs = count - 6;
    fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    fmi2ValueReference *references = calloc((size_t)outputs + 1, sizeof *references);
    double *values = calloc((size_t)outputs + 1, sizeof *values);
    for (int i = 0; i < outputs; ++i) {
        references[i] = (fmi2ValueReference)strtoul(words[6 + i], NULL, 10);
    }

    fmi2InstantiateTYPE *instantiate = (fmi2InstantiateTYPE *)function("fmi2Instantiate");
    fmi2SetupExperimentTYPE *setup = (fmi2SetupExperimentTYPE *)function("fmi2SetupExperiment");
    fmi2EnterInitializationModeTYPE *enter =
        (fmi2EnterInitializationModeTYPE *)function("fmi2EnterInitializationMode");
    fmi2ExitInitializationModeTYPE *leave =
        (fmi2ExitInitializationModeTYPE *)function("fmi2ExitInitializationMode");
    fmi2DoStepTYPE *step = (fmi2DoStepTYPE *)function("fmi2DoStep");
    fmi2GetRealTYPE *get = (fmi2GetRealTYPE *)function("fmi2GetReal");
    fmi2TerminateTYPE *terminate = (fmi2TerminateTYPE *)function("fmi2Terminate");
    fmi2FreeInstanceTYPE *dispose = (fmi2FreeInstanceTYPE *)function("fmi2FreeInstance");

    fmi2Component c =
        instantiate("hosted", fmi2CoSimulation, words[0], words[1], &callbacks, fmi2False, fmi2True);
    if (c == NULL) {
        fprintf(stderr, "fmi2Instantiate returned a null pointer\n");
        exit(1);
    }
    require(setup(c, fmi2False, 0.0, start, fmi2False, 0.0), "fmi2SetupExperiment");
    require(enter(c), "fmi2EnterInitializationMode");
    require(leave(c), "fmi2ExitInitializationMode");
    for (int k = 0; k < steps; ++k) {
        require(step(c, start + k * size, size, fmi2True), "fmi2DoStep");
        require(get(c, references, (size_t)outputs, values), "fmi2GetReal");
        for (int i = 0; i < outputs; ++i) {
            fprintf(results, "%a ", values[i]);
        }
        fputc('\n', results);
    }
    require(terminate(c), "fmi2Terminate");
    dispose(c);
    free(references);
    free(values);
}

int main(int count, char *words[])
{
#ifdef __linux__
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* A host must not outlive the check. */
#endif
    if (count < 3) {
        fprintf(stderr, "usage: host load|run LIBRARY ...\n");
        return 2;
    }
    /* Loaded alone, all symbols have to be there; running, those that are called. */
    int binding = strcmp(words[1], "load") == 0 ? RTLD_NOW : RTLD_LAZY;
    library = dlopen(words[2], binding | RTLD_LOCAL);
    if (library == NULL) {
        fprintf(stderr, "%s\n", dlerror());
        return 2;
    }
    if (strcmp(words[1], "run") == 0 && count >= 9) {
        FILE *results = fopen(words[8], "w");
        if (results == NULL) {
            perror(words[8]);
            return 2;
        }
        run(words + 3, count - 3, results);
        fclose(results);
    }
    dlclose(library);
    return 0;
}
