"""The scalar example of Sec. II."""

from __future__ import annotations

from congelation.theory.adaptation import AdaptationFactory, gradient
from congelation.theory.model import (
    Domain,
    Input,
    Model,
    Output,
    Parameter,
    State,
    control,
    scalar,
    vector,
)

__all__ = ["scalar_controller", "scalar_plant"]


def scalar_plant() -> Model:
    """The plant (2), x' = -theta x + u."""
    x = scalar("x", "State x of (2)")
    u = scalar("u", "Input u of (2)")
    theta = vector("theta", 1, "Unknown parameter theta(t) of (2)", "1/s")
    rate = -theta.symbol * x.symbol + u.symbol
    return Model(
        name="ScalarPlant",
        description="Scalar plant (2): x' = -theta(t) x + u",
        inputs=(Input.of(u),),
        states=(State(x, rate, start=(1.0,)),),
        parameters=(),
        outputs=(Output(x, differentiated=True),),
        theta=theta,
    )


def scalar_controller(adaptation: AdaptationFactory = gradient) -> Model:
    """The controller (3), u = theta_hat x - k x, theta_hat' = -gamma x^2.

    Controller 1 takes k = k_bar + 1/(2 epsilon^2) + epsilon^2 delta^2 / 2, Controller 2 k = k_bar.
    (8) prints 1/(2 epsilon); Young's inequality in (7) needs the square beside epsilon^2 delta^2.
    """
    x = scalar("x", "State x of the plant (2)")
    theta_hat = vector("theta_hat", 1, "Estimate of theta, (3)", "1/s")
    k_bar = scalar("k_bar", "Rate of decay left in V', (8)", "1/s")
    gamma = scalar("gamma", "Adaptation gain, (3)")
    epsilon = scalar("epsilon", "Weight in Young's inequality, (7)")
    delta = scalar("delta", "Radius of theta(t), Assumption 1", "1/s")
    damping = scalar("damping", "True: Controller 1, with damping; false: Controller 2")
    law = adaptation(theta_hat, gamma.symbol, 0)

    k = k_bar.symbol + damping.symbol * (  # (8)
        1 / (2 * epsilon.symbol**2) + epsilon.symbol**2 * delta.symbol**2 / 2
    )
    u = theta_hat.symbol * x.symbol - k * x.symbol  # (3)
    tau = law.regressor(-x.symbol, x.symbol) * x.symbol
    return Model(
        name="ScalarController",
        description="Adaptive controller (3) with the damping (8) for the scalar plant (2)",
        inputs=(Input.of(x),),
        states=(State(theta_hat, gamma.symbol * law.rate(tau), start=(0.0,)),),
        parameters=(
            Parameter(k_bar, (1.0,), Domain.POSITIVE),
            Parameter(gamma, (1.0,), Domain.POSITIVE),
            Parameter(epsilon, (1.0,), Domain.POSITIVE),
            Parameter(delta, (1.0,), Domain.NONNEGATIVE),
            Parameter(damping, (1.0,), Domain.BOOLEAN),
            *law.parameters,
        ),
        outputs=(
            control(u, "Control u of (3)"),
            Output(theta_hat),
        ),
    )
