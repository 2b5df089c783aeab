/* An example: one line of measurements in, one line with u out.

       cc -O2 controller.c main.c -lm -o controller
       echo "0.5 -0.2" | ./controller 0.001 */

#include <stdio.h>
#include <stdlib.h>

#include "controller.h"

int main(int count, char **arguments)
{
    @name@ c;
    double y[@NAME@_INPUTS], sample_time = count == 2 ? atof(arguments[1]) : 0.0;
    if (!(sample_time > 0.0)) {
        fprintf(stderr, "%s SAMPLE_TIME: seconds, above 0\n", arguments[0]);
        return 2;
    }
    @name@_init(&c);
    for (;;) {
        for (int i = 0; i < @NAME@_INPUTS; i++)
            if (scanf("%lf", &y[i]) != 1) return c.faults > 0;
        printf("%.17g\n", @name@_step(&c, y, sample_time));
        fflush(stdout);
    }
}
