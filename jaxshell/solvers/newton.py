"""Newton's iteration for one step: its settings, and the derivative of what it finds.

The iteration ends when the correction that WOULD follow is predicted below the tolerance, from the contraction seen
so far or from the residual, so that no solve is spent only to see that it was small; and when the energy that the step
leaves unbalanced is within the tolerance of the work that it exchanges. A failed iteration is a result with its
numbers, never a NaN. There are two: `jaxshell.solvers.full_newton` and `jaxshell.solvers.chord_newton`.
"""

from collections.abc import Callable

import equinox as eqx

from jaxshell.numerics.checks import Real, check_choice, check_count, check_positive_number, check_switch
from jaxshell.numerics.derived import derived
from jaxshell.solvers import chord_newton, full_newton
from jaxshell.solvers.iteration import Linear, Measure, Memory, Problem, Start


class Newton(eqx.Module):
    """How a step's nonlinear equations are solved.

    Arguments:
        tolerance: of the scaled correction (fraction of the shell's size, radians), and of the energy left unbalanced
            (fraction of the work that elements and loads do in the step); with criterion="norm" of the Euclidean norm
            of the raw correction ‖ΔQ‖ alone, in the user's units.
        max_iterations: corrections allowed in a step; and as many again where kept factorizations failed and the
            step is done anew without them.
        max_rotation: a correction is scaled down so that no nodal rotation in it exceeds this [rad].
        reuse: keep a factorization over iterations and steps while it contracts well (chord Newton): more
            corrections, each far cheaper, and a predicted one a thousand times below the tolerance at the end (a
            hundred times with joints' multipliers, and near round-off).
            False factors in every iteration, which statics does by default.
        criterion: "predicted" (the correction that would follow) or "norm" (‖ΔQ‖ of the last one, as the paper
            does with 1e-6).

    Raises ValueError for values that are not positive and unknown criteria.
    """

    tolerance: Real = 1e-8
    max_iterations: int = eqx.field(static=True, default=25)
    max_rotation: Real = 0.3
    reuse: bool = eqx.field(static=True, default=True)
    criterion: str = eqx.field(static=True, default="predicted")

    def __check_init__(self):
        check_positive_number("Newton tolerance", self.tolerance)
        check_positive_number("Newton max_rotation", self.max_rotation)
        check_count("Newton max_iterations", self.max_iterations)
        check_switch("Newton reuse", self.reuse)
        check_choice("Newton criterion", self.criterion, ("predicted", "norm"))

    def solve(self, problem: Problem, guess, size, rotates, linear: Linear, memory: Memory, calm=None):
        """Iterate from `guess` (nf,): (Solved, Memory for the next step).

        `size` [length] and the mask `rotates` (nf,) scale the corrections. `calm` (nf,) is another guess, for where the
        first is far off. Not to be differentiated: see `attach_derivative`.
        """
        iterate = chord_newton.iterate if self.reuse else full_newton.iterate
        measure = Measure(size, rotates, self.max_rotation)
        return iterate(self, problem, Start.of(guess, calm), measure, linear, memory)


def attach_derivative(linear: Linear, residual: Callable, tangent: Callable, free, parameters):
    """`free` (nf,), with the derivatives of the solution of residual(free, parameters) = 0, of every order.

    residual(free, parameters) → (nf,) and tangent(free, parameters) → values of the matrix ∂residual/∂free are pure
    functions: all that JAX may trace is in `parameters`, a pytree of arrays and static values. By the implicit function
    theorem d free = -K⁻¹ ∂residual/∂parameters d parameters, with K at the solution: where this is differentiated again
    the solution and K move with the parameters. Only what is differentiated is: parameters that do not move cost
    nothing, and where none does neither function is used.
    """

    def change(free, both, along):
        linear, parameters = both
        unbalanced = along(lambda both: residual(free, both[1]))
        return -linear.solve_once(tangent(free, parameters), unbalanced)

    return derived(change, free, (linear, parameters))
