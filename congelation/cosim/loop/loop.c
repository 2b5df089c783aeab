/* The stepping loop, compiled: what stepping.py and the couplings do in each communication step.

   It makes the steps of a run and its jumps, and nothing else. Where anything else happens (an FMU that
   does not return fmi2OK, a value that is not finite, iterations that do not converge, a full block of
   rows), it returns, and Python goes on from there: it has the messages and the ends of runs. The arrays
   are those of the Python loop, and the arithmetic is in its order.

   The parts are compiled as one unit, so that small functions are inlined without options for the linker. */

#include "structures.h"

/* Raised with each change of a structure or a function here: a library of another version, left over
   from an earlier installation, is not used. */
EXPORT int loop_version(void) { return 9; }

#include "calls.c"
#include "recording.c"
#include "quasi_newton.c"
#include "exchange.c"
#include "held.c"
#include "trial.c"
#include "polynomials.c"
#include "hermite.c"
#include "derivative.c"
#include "halves.c"
#include "time.c"
#include "model_exchange.c"
