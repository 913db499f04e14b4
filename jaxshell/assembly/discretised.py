"""The model: a scene turned into arrays (elements, loads, supports, tables), built inside the compiled program."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxshell.assembly.acting import Acting
from jaxshell.assembly.driven import Motion, motions_of
from jaxshell.assembly.elements import build_elements
from jaxshell.assembly.elimination import Blocks, Elimination
from jaxshell.assembly.gauges import Watching, watching
from jaxshell.assembly.lumps import Lumps
from jaxshell.assembly.prepared import (
    acting_in,
    acting_on_bending,
    elimination_of,
    lumps_in,
    membrane_scale,
    nodal_load,
    rest_deformations,
    size_of,
)
from jaxshell.assembly.readings import Reading, readings
from jaxshell.assembly.tables import Tables
from jaxshell.elements import corotational
from jaxshell.elements.cubic_inertia import levers
from jaxshell.elements.element import Element
from jaxshell.model.contribution import Surface
from jaxshell.model.damping import Damping
from jaxshell.model.history import History
from jaxshell.model.loads import DeadLoad
from jaxshell.model.scene import Scene
from jaxshell.numerics.fusion import formed
from jaxshell.numerics.kernels import each


class Model(eqx.Module):
    """A scene as arrays: what the methods compute with. Differentiable in every float of the scene."""

    x0: Float[Array, "n 3"]
    elements: Element
    """Each field with a leading axis over the m elements."""
    dead_loads: tuple[tuple[Float[Array, "n 6"], History], ...]
    contributions: tuple[Acting, ...]
    rests: tuple[tuple[Float[Array, "m 12"], History], ...]
    """Deformations at which the elements are free of stress, for every initial strain of the scene."""
    moving: tuple[Motion, ...]
    """The prescribed motions of supports."""
    size: Float[Array, ""]
    """The shell's size, the diagonal of its bounding box [length]: the scale of convergence."""
    tables: Tables
    damping: Damping | None = None
    gauges: tuple[Watching, ...] = ()
    """What reads the stresses and section forces that the scene watches."""
    elimination: Elimination | None = None
    """None where every node's own degrees of freedom are unknown or held."""
    lumps: Lumps | None = None
    """The point masses; None where there are none."""
    multiplier_unit: Float[Array, ""] | None = None
    """What a multiplier of 1 means [force/length]; None where there are none."""
    readings: tuple[Reading, ...] = ()
    """What reads the connectors and obstacles that it watches."""

    @classmethod
    def build(cls, scene: Scene, tables: Tables, bends_mass: bool = False) -> "Model":
        """The model of a scene; `tables` are of its `structure_of`. `bends_mass` as the method has it."""
        x0 = jnp.concatenate([scene.mesh.nodes, jnp.zeros((tables.multipliers, 3))])
        resultants = scene.section.resultants(scene.mesh)
        elements = build_elements(scene, resultants, bends_mass=bends_mass, triangles=tables.triangles)
        lumps = lumps_in(scene, tables)
        dead = tuple(
            (nodal_load(load, x0, tables, elements, lumps), load.history)
            for load in scene.loads
            if isinstance(load, DeadLoad)
        )
        size = size_of(scene)
        surface = Surface(
            x0,
            tables.triangles,
            elements.mass_per_area,
            elements.area,
            elements.frame[:, 2],
            jax.lax.stop_gradient(size),
            resultants.A,
            lambda: scene.section.layers(scene.mesh),
            scene.mesh.triangles,
            elements.rotary_inertia,
            elements.first_moment,
            levers(elements) if bends_mass else None,
        )
        moving = motions_of(scene.supports, x0, scene.initial)
        damping = None if scene.damping is None else scene.damping.per_element(scene.mesh.n_elements)
        unit = membrane_scale(elements, lumps) if tables.multipliers else None
        acting = acting_in(scene, tables, surface, unit)
        if bends_mass:
            acting += acting_on_bending(scene, tables, surface)
        histories = (load.history for load in scene.initial_strains)
        rests = tuple(zip(rest_deformations(scene, elements), histories, strict=True))
        gauges, elimination = watching(scene, elements), elimination_of(scene, tables)
        found = gauges, elimination, lumps, unit, readings(scene)
        return cls(x0, elements, dead, acting, rests, moving, size, tables, damping, *found)

    def elements_at(self, *weighted: tuple[Any, Any]) -> Element:
        """The elements with the mean of their stress-free states at some times: (weight, time) each.

        Where the scene has no initial strains, `elements` themselves.
        """
        if not self.rests:
            return self.elements
        rest = sum((weight * self.rest(time) for weight, time in weighted), jnp.zeros(()))
        return self.elements.resting_at(rest)

    def rest(self, time) -> Float[Array, "m 12"]:
        """The deformations at which the elements are free of stress, of a scene that has initial strains."""
        found = jnp.zeros((len(self.elements.area), 12))
        for deformations, history in self.rests:
            found = found + history(time) * deformations
        return found

    @property
    def units(self) -> Float[Array, " nf"]:
        """In what the free degrees of freedom are measured where equations are solved: the diagonal S in S K S.

        Displacements in the shell's size and rotations in radians, both times the root of one over its bending
        stiffness, so that S K S has no unit and its entries are near 1 (a pivot below 1e-13 is zero to Pardiso). Powers
        of two, so that a change of units is exact; constants for derivatives.
        """
        size, stiffness = jax.lax.stop_gradient((self.size, self.bending_scale))
        root = jnp.ldexp(1.0, -jnp.frexp(stiffness)[1] // 2)
        length = jnp.ldexp(1.0, jnp.frexp(size)[1])
        return root * jnp.where(self.tables.free % 6 < 3, length, 1.0)

    @property
    def soft(self) -> tuple[Int[Array, " q"], Float[Array, " q"]] | None:
        """Places of the zeros that multipliers have on the diagonal, and the squares of the entries of their rows, in
        the units of the unknowns. None where there are none."""
        if self.tables.zeros is None or self.multiplier_unit is None:
            return None
        rows = self.multiplier_unit * self.units[self.tables.constrained] ** 2
        return self.tables.zeros, rows * rows

    def whole(self, given, default):
        """Nodal values of the mesh's nodes, with the default ones (n, ...) of the multipliers'."""
        given = jnp.asarray(given)
        return given if not self.tables.multipliers else default.at[: self.tables.nodes].set(given)

    def multipliers_at(self, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"], time) -> Float[Array, "n 3"]:
        """x with the multipliers at which the forces are in balance, as nearly as they can be (least squares)."""
        assert self.tables.constrained is not None
        still = jnp.zeros((x.shape[0], 6))
        no_motion, free = jnp.zeros(self.tables.held.shape), jnp.zeros(self.tables.free.shape)

        def placed(values):
            return x + self.expand(free.at[self.tables.constrained].set(values), no_motion)[:, :3]

        def forces(values):
            total = still
            for acting in self.constraints:
                place = acting.places(placed(values), R, time)
                total = total + self.sum_over_nodes(acting, acting.balanced(place))
            found = self.free(self.collected(total, R))
            return (self.units * found).at[self.tables.constrained].set(0.0)

        unbalanced = self.internal_force(x, R, time) - self.external_load(x, R, time)
        unbalanced = self.units * self.free(self.collected(unbalanced, R))
        slopes = jax.jacfwd(forces)(jnp.zeros(self.tables.constrained.shape))
        return placed(jnp.linalg.solve(slopes.T @ slopes, slopes.T @ unbalanced))

    @property
    def frequency_scale(self) -> Float[Array, ""]:
        """D/(m L⁴): a scale of ω² below the bending frequencies of a shell of that size, without curvature."""
        if not self.elements.area.size:
            return jnp.ones(())
        return self.bending_scale / (jnp.mean(self.elements.mass_per_area) * self.size**4)

    @property
    def bending_scale(self) -> Float[Array, ""]:
        """The shell's plate rigidity D, about: the bending stiffness of an element with like sides [force·length].

        Without a shell a number of the masses' size.
        """
        if not self.elements.area.size:
            return self.size**2 * (jnp.ones(()) if self.lumps is None else jnp.sum(self.lumps.mass))
        return jnp.mean(jnp.trace(self.elements.K_bending, axis1=1, axis2=2)) / 6.0

    def gather(self, nodal):
        """(n, ...) nodal values → (m, 3, ...) at the elements' corners; for every leaf of a pytree."""
        return jax.tree.map(lambda values: values[self.tables.triangles], nodal)

    def assemble_vector(self, corner: Float[Array, "m 18"]) -> Float[Array, "n 6"]:
        """Sum of element vectors over the nodes."""
        return self.tables.nodal(corner.reshape(-1, 6))

    def assemble_matrix(
        self, matrices: Float[Array, "m 18 18"], others=(), blocks: Blocks | None = None, turning=None
    ) -> Float[Array, " nnz"]:
        """Values of the sparse matrix over the free degrees of freedom.

        `others` are (acting, its matrices (k, 6c, 6c)) of contributions. Where there is an `elimination`, `blocks` are
        of its `blocks` and `turning` of that, or None.
        """
        for acting, own in others:
            if acting.on_elements:
                matrices = matrices + own
        if blocks is not None:
            matrices, others = self._reduced(matrices, others, blocks)
        values = self.tables.matrix(formed(matrices).reshape(-1))
        if self.tables.own is not None:
            values = jnp.append(values, 0.0)[self.tables.own]
        for acting, own in others:
            if not acting.on_elements:
                values = values.at[acting.entries].add(own.reshape(-1), mode="drop")
        if turning is not None and self.elimination is not None:
            values = values.at[self.elimination.dependent.entries].add(turning.reshape(-1), mode="drop")
        return values

    def _reduced(self, matrices: Float[Array, "m 18 18"], others, blocks: Blocks):
        """Matrices by the unknowns of those by the nodes' increments."""
        assert self.elimination is not None
        touched = self.elimination.dependent.touched
        own = blocks.of(self.tables.triangles[touched], matrices[touched])
        others = [(a, m if a.on_elements else blocks.of(a.nodes, m)) for a, m in others]
        return matrices.at[touched].set(own), others

    def sum_over_nodes(self, acting: Acting, forces: Float[Array, "k c 6"]) -> Float[Array, "n 6"]:
        """Forces of a contribution's groups summed over the nodes."""
        if acting.on_elements:
            return self.assemble_vector(forces.reshape(-1, 18))
        return jnp.zeros((self.x0.shape[0], 6)).at[acting.nodes].add(forces)

    def free(self, nodal: Float[Array, "n 6"]) -> Float[Array, " nf"]:
        """The entries of a nodal vector at the free degrees of freedom."""
        return nodal.reshape(-1)[self.tables.free]

    def expand(self, free: Float[Array, " nf"], held: Float[Array, " nh"]) -> Float[Array, "n 6"]:
        """The nodal vector with the given entries at free and held degrees of freedom."""
        return jnp.concatenate([free, held])[self.tables.place].reshape(-1, 6)

    def without_multipliers(self, nodal: Float[Array, "n 6"]) -> Float[Array, "n 6"]:
        """Increments with zeros in place of the multipliers', which are no motions."""
        return nodal.at[self.tables.nodes :].set(0.0) if self.tables.multipliers else nodal

    def unknowns(self, nodal: Float[Array, "n 6"]) -> Float[Array, " nf"]:
        """The free unknowns of nodal increments: along the nodes' own axes where they have some."""
        return self.free(nodal if self.elimination is None else self.elimination.along(nodal))

    def along_held(self, nodal: Float[Array, "n 6"]) -> Float[Array, " nh"]:
        """The held entries of nodal increments, along the nodes' own axes where they have some."""
        along = nodal if self.elimination is None else self.elimination.along(nodal)
        return along.reshape(-1)[self.tables.held]

    def spread(self, free: Float[Array, " nf"], held: Float[Array, " nh"], R: Float[Array, "n 3 3"]):
        """Displacements and spins of all nodes (n, 6) about a state with the rotations R, linearly."""
        nodal = self.expand(free, held)
        if self.elimination is None:
            return nodal
        return self.elimination.nodal(nodal, R, lambda theta: jnp.eye(3))

    def collected(self, nodal: Float[Array, "n 6"], R: Float[Array, "n 3 3"]) -> Float[Array, "n 6"]:
        """Forces and moments in a state with the rotations R at the unknowns: what `spread` is the transpose of."""
        if self.elimination is None:
            return nodal
        return self.elimination.collected(nodal, self._arms(R))

    def _arms(self, R: Float[Array, "n 3 3"]) -> Float[Array, "k 3"]:
        assert self.elimination is not None
        return jnp.einsum("kij,kj->ki", R[self.elimination.masters], self.elimination.arms)

    def matrix_at(self, R: Float[Array, "n 3 3"], matrices, others=(), forces=None) -> Float[Array, " nnz"]:
        """As `assemble_matrix`, of matrices by displacements and spins about a state with the rotations R.

        `forces` (n, 6) are the state's at the nodes, where the matrices are derivatives of them.
        """
        if self.elimination is None:
            return self.assemble_matrix(matrices, others)
        arms, spin = self._arms(R), jnp.broadcast_to(jnp.eye(3), R.shape)
        turning = None if forces is None else self.elimination.turning(forces, arms, spin, 1.0)
        return self.assemble_matrix(matrices, others, self.elimination.blocks(arms, arms, spin), turning)

    def held_displacement(self, time) -> Float[Array, " nh"]:
        """Displacements of the held degrees of freedom at `time`; zero at rotations and where nothing is prescribed."""
        return self._held([(motion, motion.displacements(time)) for motion in self.moving])

    def held_increment(self, time, dt, size=lambda angle: angle) -> Float[Array, " nh"]:
        """Increments of the held degrees of freedom in the step from `time`.

        `size` makes of the angle of a turn about an axis the size of the method's parameters, by default rotation
        vectors.
        """
        change = self.held_displacement(time + dt) - self.held_displacement(time)
        if not self.turns:
            return change
        turned = [(motion, motion.turns(time, dt, size)) for motion in self.moving if motion.turning]
        return change + self._held(turned)

    def held_rates(self, time) -> Float[Array, " nh"]:
        """Prescribed velocities and angular velocities of the held degrees of freedom from `time` on."""
        return self._held([(motion, motion.rates(time)) for motion in self.moving])

    def held_accelerations(self, time) -> Float[Array, " nh"]:
        """Prescribed accelerations of the held degrees of freedom at `time`; zero at rotations."""
        return self._held([(motion, motion.accelerations(time)) for motion in self.moving])

    @property
    def turns(self) -> bool:
        """Whether a support prescribes rotations."""
        return any(motion.turning for motion in self.moving)

    def _held(self, prescribed: Sequence[tuple[Motion, Any]]) -> Float[Array, " nh"]:
        """Values (k, d) of motions at the held degrees of freedom; zero where there are none."""
        values = jnp.zeros(self.x0.shape[0] * 6)
        for motion, of_it in prescribed:
            values = values.at[motion.numbers.array].set(of_it)
        return values[self.tables.held]

    def dead_load(self, time) -> Float[Array, "n 6"]:
        """Nodal forces and moments of all loads with a fixed direction at `time`."""
        total = jnp.zeros((self.x0.shape[0], 6))
        for pattern, history in self.dead_loads:
            total = total + history(time) * pattern
        return total

    @property
    def elastic(self) -> tuple[Acting, ...]:
        """The contributions that have an energy of their own."""
        return tuple(acting for acting in self.contributions if acting.is_elastic)

    @property
    def driven(self) -> tuple[Acting, ...]:
        """Those of them that are moved from outside."""
        return tuple(acting for acting in self.contributions if acting.is_driven)

    @property
    def resisting(self) -> tuple[Acting, ...]:
        """The contributions that take energy."""
        return tuple(acting for acting in self.contributions if acting.resists)

    @property
    def constraints(self) -> tuple[Acting, ...]:
        """The contributions that are conditions with multipliers."""
        return tuple(acting for acting in self.contributions if acting.constrains)

    @property
    def dissipates(self) -> bool:
        """Static: whether the scene has damping, or contributions that take energy."""
        return self.damping is not None or bool(self.resisting)

    def sum_of(self, actings: tuple[Acting, ...], x, R, time) -> Float[Array, "n 6"]:
        """Nodal forces and moments of some contributions at positions x and rotations R."""
        total = jnp.zeros((self.x0.shape[0], 6))
        for acting in actings:
            total = total + self.sum_over_nodes(acting, acting.forces(acting.places(x, R, time)))
        return total

    def following_load(self, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"], time) -> Float[Array, "n 6"]:
        """Nodal forces and moments of all contributions at positions x and rotations R."""
        return self.sum_of(tuple(a for a in self.contributions if a.is_plain or a.is_elastic), x, R, time)

    def external_load(self, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"], time) -> Float[Array, "n 6"]:
        """All loads at `time`."""
        load = self.dead_load(time)
        following = tuple(a for a in self.contributions if a.is_plain)
        return load + self.sum_of(following, x, R, time) if following else load

    def following_stiffness(self, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"], time):
        """Derivative of `following_load` by displacements and spins, for `assemble_matrix`, and negative, as it stands
        in the stiffness."""
        return self.stiffness_of(tuple(a for a in self.contributions if a.is_plain or a.is_elastic), x, R, time)

    def stiffness_of(self, actings: tuple[Acting, ...], x, R, time) -> list[tuple[Acting, Float[Array, "k d d"]]]:
        """The same of some contributions."""
        return [(acting, -acting.stiffness(acting.places(x, R, time))) for acting in actings]

    def resistance(self, before: tuple, after: tuple, rates: Float[Array, "n 6"]) -> Float[Array, "n 6"]:
        """Nodal forces and moments of what resists, at the end of a step, (x, R, time) each, with these rates."""
        total = jnp.zeros((self.x0.shape[0], 6))
        for acting in self.resisting:
            start, end = acting.places(*before), acting.places(*after)
            total = total + self.sum_over_nodes(acting, acting.resistance(start, end, end, rates[acting.nodes]))
        return total

    def work_through_resistance(self, before: tuple, after: tuple, rates: Float[Array, "n 6"]) -> Float[Array, ""]:
        """Work done in a step by what moves the things that resist: forces as `resistance` has them."""
        total = jnp.zeros(())
        for acting in self.resisting:
            if acting.is_carried:
                start, end = acting.places(*before), acting.places(*after)
                forces = acting.resistance(start, end, end, rates[acting.nodes])
                total = total + jnp.sum(forces * acting.carried(start, end))
        return total

    def strain_energy(self, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"], time) -> Float[Array, ""]:
        """Strain energy of the shell, eq. (61) summed over the elements, and the energy of elastic contributions."""

        def one(x, R, element):
            return corotational.strain_energy(corotational.kinematics(x, R, element).deformations, element)

        total = jnp.sum(each(one)(self.gather(x), self.gather(R), self.elements_at((1.0, time))))
        return total + self.energy_of(self.elastic, x, R, time) if self.elastic else total

    def energy_of(self, actings: tuple[Acting, ...], x, R, time) -> Float[Array, ""]:
        """Energy of some elastic contributions."""
        return sum((acting.energy(acting.places(x, R, time)) for acting in actings), jnp.zeros(()))

    def work_of_drives(self, before: tuple, after: tuple, u) -> Float[Array, ""]:
        """Work done in a step by what moves elastic contributions from outside, by the trapezoidal rule.

        `before` and `after` are (x, R, time): the change of their energy and what they do on the increments u.
        """
        if not self.driven:
            return jnp.zeros(())
        change = self.energy_of(self.driven, *after) - self.energy_of(self.driven, *before)
        return change + 0.5 * jnp.sum((self.sum_of(self.driven, *before) + self.sum_of(self.driven, *after)) * u)

    def work_of_rests(self, before: tuple, after: tuple) -> Float[Array, ""]:
        """Work done by initial strains that change in a step, -Δe⁰·f with the mean stresses f of its ends.

        `before` and `after` are (x, R, time). Zero, and not computed, where the scene has no initial strains.
        """
        if not self.rests:
            return jnp.zeros(())

        def stresses(x, R, time):
            def one(x, R, element):
                return corotational.stresses(corotational.kinematics(x, R, element).deformations, element)

            return each(one)(self.gather(x), self.gather(R), self.elements_at((1.0, time)))

        change = self.rest(after[2]) - self.rest(before[2])
        return -0.5 * jnp.sum(change * (stresses(*before) + stresses(*after))[:, :12])

    def internal_force(self, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"], time) -> Float[Array, "n 6"]:
        """Nodal internal forces and moments, eq. (70) assembled, and those of elastic contributions."""
        total = self.assemble_vector(
            each(corotational.internal_force)(self.gather(x), self.gather(R), self.elements_at((1.0, time)))
        )
        return total - self.sum_of(self.elastic, x, R, time) if self.elastic else total
