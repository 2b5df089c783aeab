"""The bare controller of a spec as C for sampled control: one function, no allocation, fixed cost.

The equations are those of the FMU, from the same expression graph, with the numbers of the spec in
place of parameters and gains. The integrator is another one: the classical Runge-Kutta method with
fixed steps, whose cost is the same in every sample.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import casadi as ca

from congelation.export.equations import constants_of, equation_blocks
from congelation.export.spec import FmuSpec
from congelation.export.straight_line import Block, c_function, operations
from congelation.theory.model import Model
from congelation.theory.values import complete_values

__all__ = ["controller_code"]

SUBSTEPS = 4
"""Runge-Kutta steps in each sample, where the compiler is not told another number."""


def controller_code(fmu: FmuSpec, folder: Path) -> list[Path]:
    """Write ``controller.h``, ``controller.c`` and an example ``main.c``.

    Parameters
    ----------
    fmu : FmuSpec
        A controller; the defaults of its parameters and start values are what the code holds.
    folder : Path
        Made if it is not there.

    Returns
    -------
    list of Path
        The three files.

    Raises
    ------
    InvalidInput, InfeasibleDesign
        A gain cannot be computed from the parameters.
    """
    values = complete_values(fmu.model)
    texts = _texts(fmu, [float(x) for name in _groups(fmu.model) for x in values[name].ravel()])
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / name for name in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        path.write_text(text, "utf-8")
    return paths


def _groups(model: Model) -> list[str]:
    """The names of what `constants_of` lists, vectors and matrices in one."""
    return [p.variables.name for p in model.parameters] + [g.variables.name for g in model.gains]


def _texts(fmu: FmuSpec, numbers: list[float]) -> dict[str, str]:
    """The three files by name, with the numbers of parameters and gains."""
    model = fmu.model
    known = {name: number for (name, _), number in zip(constants_of(model), numbers, strict=True)}
    # The simpler equations, where the settings of the adaptation law are neutral.
    simple = fmu.special
    if simple is not None and all(known[k] == float(v) for k, v in simple.values.items()):
        model = simple.model
    symbols = [symbol for _, symbol in constants_of(model)]
    values = [known[name] for name, _ in constants_of(model)]

    def numeric(block: Block) -> Block:
        results = ca.vertcat(*block.results)
        results = ca.substitute(results, ca.vertcat(*symbols), ca.vertcat(*values))
        arguments = tuple(
            (new, group) for (_, group), new in zip(block.arguments, ("x", "y"), strict=True)
        )
        return replace(block, arguments=arguments, results=tuple(ca.vertsplit(results)))

    rates, outputs = (numeric(block) for block in [*equation_blocks(model)][:2])
    control = replace(outputs, name="control", results=outputs.results[:1], doc="The control u.")
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", fmu.name).lower()
    inputs = [
        (element, unit)
        for i in model.inputs
        for element, unit in zip(i.variables.names, i.variables.units, strict=True)
    ]
    states = [
        (element, unit, start)
        for s in fmu.model.states
        for element, unit, start in zip(s.variables.names, s.variables.units, s.start, strict=True)
    ]
    words = {
        "name": name,
        "NAME": name.upper(),
        "title": model.description,
        "inputs": str(len(inputs)),
        "states": str(len(states)),
        "input_list": _listed("y", inputs),
        "state_list": _listed("x", [(element, unit) for element, unit, _ in states]),
        "parameters": "\n".join(f"     {k} = {v:.9g}" for k, v in known.items()),
        "substeps": str(SUBSTEPS),
        "cost": _cost(control, rates, len(states)),
        "equations": "\n".join([*c_function(control), "", *c_function(rates)]),
        "starts": "\n".join(
            f"    c->x[{i}] = {float(start)!r}; /* {element} */"
            for i, (element, _, start) in enumerate(states)
        ),
    }
    return {
        file: re.sub(r"@(\w+)@", lambda found: words[found[1]], template)
        for file, template in (
            ("controller.h", _HEADER),
            ("controller.c", _SOURCE),
            ("main.c", _MAIN),
        )
    }


def _listed(array: str, names: list[tuple[str, str]]) -> str:
    return "\n".join(
        f"     {array}[{i}]  {name}{f' in {unit}' if unit else ''}"
        for i, (name, unit) in enumerate(names)
    )


def _cost(control: Block, rates: Block, n: int) -> str:
    """The operations of one sample, for the comment in the header."""
    lines = []
    for what, block in (("u", control), ("the rates of the states", rates)):
        sums, slow, called = operations(block)
        lines.append(
            f"     {what}: {sums} sums, products and comparisons, {slow} divisions and roots, "
            f"{called} functions"
        )
    # Of each component: four points of 3 operations, four terms of 2, and the step of 2.
    lines.append(
        f"     a sample: u once, and in each substep the rates four times and {22 * n} further "
        "sums\n     and products"
    )
    return "\n".join(lines)


_HEADER = r"""/* @title@. Generated by congelation.

   A controller for sampled control. Once in each sample time, with a timer:

       static @name@ c;
       @name@_init(&c);
       for (;;) {
           .. wait for the timer, measure y ..
           double u = @name@_step(&c, y, sample_time);
           .. put out u ..
       }

   What it measures:
@input_list@
   Its states, to read, or to set after @name@_init for a warm start:
@state_list@

   Cost, the same in every sample; nothing is allocated, and nothing is global:
@cost@ */

#ifndef @NAME@_H
#define @NAME@_H

#include <stdbool.h>

/* Runge-Kutta steps of order 4 in each sample: more where the states change fast. */
#ifndef @NAME@_SUBSTEPS
#define @NAME@_SUBSTEPS @substeps@
#endif

enum { @NAME@_INPUTS = @inputs@, @NAME@_STATES = @states@ };

typedef struct {
    double x[@NAME@_STATES];
    double u;             /* of the last sample */
    unsigned long faults; /* samples that were refused */
} @name@;

/* The start values of the spec. */
void @name@_init(@name@ *c);

/* The control u for the measurements y, which acts at once; then the states move on by dt seconds,
   with y held. Where y or dt is not finite, or what follows from them is not, nothing moves, faults
   counts up, and the last u is returned. */
double @name@_step(
    @name@ *c, const double y[@NAME@_INPUTS], double dt);

#endif
"""

_SOURCE = r"""/* @title@. Generated by congelation; see controller.h. */

#include <math.h>
#include <stdbool.h>

#include "controller.h"

enum { INPUTS = @NAME@_INPUTS, N = @NAME@_STATES };

static inline double lesser(double a, double b) { return b < a ? b : a; }
static inline double greater(double a, double b) { return b > a ? b : a; }
static inline double sign_of(double a) { return (double)(a > 0.0) - (double)(a < 0.0); }

/* -- equations, with the numbers of the spec ---------------------------------------------------

@parameters@

   Gains among these follow from the others by matrix equations: to change one, change the spec and
   write this file anew. */

@equations@

/* -- controller -------------------------------------------------------------------------------- */

void @name@_init(@name@ *c)
{
@starts@
    c->u = 0.0;
    c->faults = 0;
}

static bool are_finite(const double *values, int count)
{
    for (int i = 0; i < count; i++)
        if (!isfinite(values[i])) return false;
    return true;
}

/* One step of the classical Runge-Kutta method: k_1 .. k_4 one after the other in k. */
static void substep(double *x, const double *y, double h)
{
    double k[N] = {0.0}, sum[N] = {0.0}, point[N];
    static const double node[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    for (int stage = 0; stage < 4; stage++) {
        for (int i = 0; i < N; i++) point[i] = x[i] + h * node[stage] * k[i];
        rates(point, y, k);
        for (int i = 0; i < N; i++) sum[i] += weight[stage] * k[i];
    }
    for (int i = 0; i < N; i++) x[i] += h / 6.0 * sum[i];
}

double @name@_step(
    @name@ *c, const double y[@NAME@_INPUTS], double dt)
{
    double x[N], u;
    for (int i = 0; i < N; i++) x[i] = c->x[i];
    control(x, y, &u);
    for (int step = 0; step < @NAME@_SUBSTEPS; step++)
        substep(x, y, dt / @NAME@_SUBSTEPS);
    if (!(dt > 0.0) || !isfinite(dt) || !isfinite(u) || !are_finite(y, INPUTS)
        || !are_finite(x, N)) {
        c->faults++;
        return c->u;
    }
    for (int i = 0; i < N; i++) c->x[i] = x[i];
    c->u = u;
    return u;
}
"""

_MAIN = r"""/* An example: one line of measurements in, one line with u out.

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
"""
