/* Loads the library of an FMU on Linux or Windows and prints a run of it, number by number in bits:

   driver LIBRARY GUID STEPS H INPUTS vr .. OUTPUTS vr ..

   The inputs of each step follow from its number alone. */

#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
#define OPEN(path) ((void *)LoadLibraryA(path))
#define FIND(library, name) ((void *)GetProcAddress((HMODULE)(library), name))
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW)
#define FIND(library, name) dlsym(library, name)
#endif

#include "fmi2FunctionTypes.h"

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                   fmi2String category, fmi2String text, ...)
{
    (void)environment, (void)name, (void)status, (void)category;
    fprintf(stderr, "%s\n", text);
}

static void *library;

static void *function(const char *name)
{
    void *found = FIND(library, name);
    if (!found) fprintf(stderr, "%s is not exported\n", name), exit(1);
    return found;
}

static void demand(fmi2Status status, const char *what)
{
    if (status != fmi2OK) fprintf(stderr, "%s returned %d\n", what, status), exit(1);
}

static size_t references(char ***argument, fmi2ValueReference *list)
{
    size_t count = (size_t)atoi(*(*argument)++);
    for (size_t i = 0; i < count; i++) list[i] = (fmi2ValueReference)atoi(*(*argument)++);
    return count;
}

int main(int count, char **argument)
{
    static fmi2ValueReference inputs[200], outputs[200];
    static double values[200];
    const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    if (count < 7) return 2;
    library = OPEN(argument[1]);
    if (!library) fprintf(stderr, "%s cannot be loaded\n", argument[1]), exit(1);
    int steps = atoi(argument[3]);
    double h = atof(argument[4]);
    const char *guid = argument[2];
    argument += 5;
    size_t ins = references(&argument, inputs), outs = references(&argument, outputs);

    fmi2InstantiateTYPE *instantiate = (fmi2InstantiateTYPE *)function("fmi2Instantiate");
    fmi2SetRealTYPE *set = (fmi2SetRealTYPE *)function("fmi2SetReal");
    fmi2GetRealTYPE *get = (fmi2GetRealTYPE *)function("fmi2GetReal");
    fmi2DoStepTYPE *step = (fmi2DoStepTYPE *)function("fmi2DoStep");
    fmi2Component c = instantiate("driven", fmi2CoSimulation, guid, "", &callbacks, 0, 1);
    if (!c) return 1;
    demand(((fmi2SetupExperimentTYPE *)function("fmi2SetupExperiment"))(c, 0, 0.0, 0.0, 0, 0.0),
           "fmi2SetupExperiment");
    demand(((fmi2EnterInitializationModeTYPE *)function("fmi2EnterInitializationMode"))(c), "enter");
    demand(((fmi2ExitInitializationModeTYPE *)function("fmi2ExitInitializationMode"))(c), "exit");
    for (int k = 0; k < steps; k++) {
        for (size_t i = 0; i < ins; i++)
            values[i] = ((double)((k * 37 + (int)i * 101 + 13) % 256) - 128.0) / 512.0;
        demand(set(c, inputs, ins, values), "fmi2SetReal");
        demand(step(c, k * h, h, 1), "fmi2DoStep");
        demand(get(c, outputs, outs, values), "fmi2GetReal");
        for (size_t i = 0; i < outs; i++) {
            uint64_t bits;
            memcpy(&bits, values + i, sizeof bits);
            printf("%08lx%08lx\n", (unsigned long)(bits >> 32),
                   (unsigned long)(bits & 0xFFFFFFFFu));
        }
    }
    ((fmi2FreeInstanceTYPE *)function("fmi2FreeInstance"))(c);
    return 0;
}
