"""Bathe's composite method: half a step of the trapezoidal rule, then the three-point backward Euler formula.

K.J. Bathe & M.M.I. Baig, Computers & Structures 83 (2005) 2513-2524; K.J. Bathe, 85 (2007) 437-445. With h = Δt/2

    t → t + h:   v_½ = v_0 + (h/2) (a_0 + a_½),  x_½ = x_0 + (h/2) (v_0 + v_½)
    → t + Δt:    v_1 = (3 (x_1 - x_½) - (x_½ - x_0))/Δt,  a_1 = (3 v_1 - 4 v_½ + v_0)/Δt

and the balance at t + h and at t + Δt. Two solutions a step; what the step cannot resolve is damped out.

Finite rotations: the increments of the two halves are the rotation vectors Θ = R_startᵀ θ in material form, so
that Ω_1 = (3 Θ_2 - Θ_1)/Δt and Ω̇_1 = (3 Ω_1 - 4 Ω_½ + Ω_0)/Δt. (Exactly, Θ_1 would be turned by half of Θ_2;
that is O(Δt²), of the order of the formula's own error, and nothing when the axis of rotation stays.)
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements.inertia import GAUSS_POINTS, Spins, StepFactors
from jaxshell.methods.damping import DampedState, Rates
from jaxshell.methods.method import Method, StepInfo
from jaxshell.methods.newmark import ForceLevelMethod, Newmark, NewmarkState, step_factors


class BackwardFactors(StepFactors):
    """v_1 = 3u/Δt + v*, a_1 = 9u/Δt² + a*: the increment u of the second half, and what history contributes.

    With β = 1/9, γ = 1/3 and the whole Δt these are Newmark's coefficients γ/(βΔt) and 1/(βΔt²) of u, which is
    all that the tangent needs to know.
    """

    def first(self, increment, rate, acceleration):
        return self.gamma / (self.beta * self.dt) * increment + rate

    def second(self, increment, rate, acceleration):
        return increment / (self.beta * self.dt**2) + acceleration


class ThreePointBackward(ForceLevelMethod):
    """The second half: its state's v, a, Ω, Ω̇ are v*, a*, Ω*, Ω̇*, the parts of the end's that are known."""

    balance_at_end = True

    def factors(self, dt) -> StepFactors:
        return BackwardFactors(*step_factors(1.0 / 9.0, 1.0 / 3.0, 0.0, 0.0, 2.0 * dt))


class Bathe(Method):
    """Bathe's two-step composite method. Iterations and factorizations count both halves."""

    def start(self, model: Model, scene, time, solvers=None) -> NewmarkState:
        return Newmark().start(model, scene, time, solvers)

    def observe(self, model: Model, state: NewmarkState):
        return Newmark().observe(model, state)

    def step(self, model: Model, state: NewmarkState, dt, solvers, memory):
        half, first, memory = Newmark().step(model, state, 0.5 * dt, solvers, memory)
        end, second, memory = ThreePointBackward().step(
            model, history(model, state, half, dt), 0.5 * dt, solvers, memory
        )
        info = StepInfo(
            jnp.where(first.result == 0, second.result, first.result),
            first.iterations + second.iterations,
            first.factorizations + second.factorizations,
            second.correction,
        )
        return end, info, memory

    def unbalanced(self, model: Model, before: NewmarkState, after: NewmarkState, dt):
        """Of the balance at the end; that in the middle is not told."""
        first, h = Newmark(), 0.5 * dt
        u = h * after.rates[1]
        half = first.finish(model, before, h, u, first.motion(before, u), first.begin(model, before, h))
        return ThreePointBackward().unbalanced(model, history(model, before, half, dt), after, h)


def history(model: Model, start: NewmarkState, half: NewmarkState, dt) -> NewmarkState:
    """`half` with its rates replaced by what the two known points contribute to the rates at the end."""
    increment = 0.5 * dt * half.rates[0]
    theta = jnp.asarray(GAUSS_POINTS) @ model.gather(increment[:, 3:])
    v = -increment[:, :3] / dt
    lumps = None
    if model.lumps is not None and start.lumps is not None and half.lumps is not None:
        lumps = _known(start.lumps, half.lumps, increment[model.lumps.at, 3:], dt)
    a = (3.0 * v - 4.0 * half.v + start.v) / dt
    return NewmarkState(
        time=half.time,
        x=half.x,
        R=half.R,
        v=v,
        a=a,
        spins=_known(start.spins, half.spins, theta, dt),
        external_work=half.external_work,
        reaction=half.reaction,
        rates=half.rates,
        damped=_damped(start, half, dt),
        lumps=lumps,
    )


def _known(start: Spins, half: Spins, theta: Float[Array, "*p 3"], dt) -> Spins:
    """`history` for spins; θ are their rotations in the first half."""
    Omega = -jnp.einsum("...ij,...i->...j", start.R, theta) / dt
    return Spins(half.R, Omega, (3.0 * Omega - 4.0 * half.Omega + start.Omega) / dt)


def _damped(start: NewmarkState, half: NewmarkState, dt) -> DampedState | None:
    """`history` for the rates of the deformations, whose change in the first half the trapezoidal rule gives back."""
    if half.damped is None or half.damped.rates is None or start.damped is None or start.damped.rates is None:
        return half.damped
    before, middle = start.damped.rates.first, half.damped.rates.first
    first = -0.25 * (before + middle)
    return DampedState(half.damped.dissipated, Rates(first, (3.0 * first - 4.0 * middle + before) / dt))
