"""What every method is: a state, one step as a pure function, what a step tells, how its equations are solved."""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float, Int

from jaxshell.assembly.discretised import Model
from jaxshell.numerics.checks import is_concrete
from jaxshell.solvers.iteration import Linear
from jaxshell.solvers.newton import Newton


class Observation(NamedTuple):
    """What is recorded at every step."""

    kinetic: Float[Array, ""]
    strain: Float[Array, ""]
    external_work: Float[Array, ""]
    dissipated: Float[Array, ""]
    linear: Float[Array, "3"]
    angular: Float[Array, "3"]


class StepInfo(NamedTuple):
    """How a step went."""

    result: Int[Array, ""]
    """0 or the index of a failure, see `jaxshell.solvers.iteration`."""
    iterations: Int[Array, ""]
    factorizations: Int[Array, ""]
    correction: Float[Array, ""]
    """The last correction, scaled."""


class Solvers(NamedTuple):
    """How the equations of a step are solved: made once on the host, and handed whole to every step."""

    newton: Newton
    linear: Linear
    tangent: str
    differentiated: bool = True
    """Whether the program may be transformed by JAX. Others are spared the derivative of every step."""


class Method(eqx.Module):
    """A time integrator: states, and one step as a pure function of (model, state, Δt)."""

    uses_matrix: ClassVar[bool] = True
    """Whether a step solves equations. Explicit methods do not, and nothing is analysed or kept for them."""
    controls_step: ClassVar[bool] = True
    """Whether its steps may be chosen by `StepControl`."""
    balances_means: ClassVar[bool] = False
    """Contributions enter with their means over the step; else with their forces at its end."""
    bends_mass: ClassVar[bool] = False
    """Static: whether the elements' masses follow the rotations (`jaxshell.elements.cubic_inertia`)."""
    has_rates: ClassVar[bool] = True
    """Whether anything moves in time: else nothing resists."""

    def check(self, scene, steps) -> None:
        """Raise ValueError where the method cannot run `scene` with these step sizes; before compilation."""

    @abc.abstractmethod
    def start(self, model: Model, scene, time, solvers: Solvers | None = None) -> Any:
        """The state at the start; `solvers` are needed where joints or rigid bodies bind accelerations."""

    @abc.abstractmethod
    def observe(self, model: Model, state) -> Observation:
        """Energies and momenta of a state."""

    @abc.abstractmethod
    def step(self, model: Model, state, dt, solvers: Solvers, memory) -> tuple[Any, StepInfo, Any]:
        """One step: the new state, how it went, and Newton's memory (factorization, contraction) for the next."""

    @abc.abstractmethod
    def unbalanced(self, model: Model, before, after, dt) -> Float[Array, "n 6"]:
        """Inertial plus internal minus external forces in the balance of the step between two states.

        At held degrees of freedom what the supports carry, at free ones what Newton has left.
        """


def may_have_first_moment(scene) -> bool:
    """Whether ∫ρz dz of some element is more than round-off, or not known because JAX traces it."""
    moment = scene.section.resultants(scene.mesh).first_moment
    return moment is not None and (not is_concrete(moment) or scene.section.has_first_moment(scene.mesh))
