"""From elements to the structure: gather tables made once, and sums that need no scatter.

Each entry of the global residual or matrix is a sum over a few element entries. Their positions are known, so
the sum is a handful of gathers over targets sorted by their number of contributions: contiguous, vectorised,
deterministic, and without the write conflicts that make scatters slow.
"""

import dataclasses
import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshell.assembly.sparsity import SparsityPattern
from jaxshell.numerics.checks import index_array
from jaxshell.numerics.frozen import Frozen

_GATHERED = 8
"""Contributions per target summed by gathers; the rest, at hubs of a mesh only, by a scatter."""


class GatherSum(eqx.Module):
    """Sums of entries: `target[i] = Σ source[k]` over the k that belong to i."""

    layers: tuple[Int[Array, " _"], ...]
    """Layer j: the j-th contribution of those targets that have one, targets in descending order of count."""
    order: Int[Array, " size"]
    """Position of each target in that order."""
    extra: tuple[Int[Array, " e"], Int[Array, " e"]] | None
    """(source, target position) beyond the gathered layers."""
    empty: int = eqx.field(static=True, default=0)
    """How many targets have no source, and the sum 0."""

    @classmethod
    def build(cls, targets: np.ndarray, sources: np.ndarray, size: int) -> "GatherSum":
        """From pairs (target, source)."""
        by_target = np.argsort(targets, kind="stable")
        targets, sources = targets[by_target], sources[by_target]
        count = np.bincount(targets, minlength=size)
        rank = np.arange(targets.size) - np.repeat(np.cumsum(count) - count, count)
        descending = np.argsort(-count, kind="stable")
        order = np.empty(size, np.int64)
        order[descending] = np.arange(size)
        layers, position = [], order[targets]
        for j in range(min(_GATHERED, int(count.max(initial=0)))):
            chosen = rank == j
            layer = np.empty(chosen.sum(), np.int64)
            layer[position[chosen]] = sources[chosen]
            layers.append(index_array(layer))
        beyond = rank >= _GATHERED
        extra = (index_array(sources[beyond]), index_array(position[beyond])) if beyond.any() else None
        return cls(tuple(layers), index_array(order), extra, int(np.sum(count == 0)))

    def __call__(self, source: Float[Array, "s *rest"]) -> Float[Array, "size *rest"]:
        if not self.layers:
            return jnp.zeros((self.empty, *source.shape[1:]))
        total = source[self.layers[0]]
        for layer in self.layers[1:]:
            head = total[: layer.shape[0]] + source[layer]
            total = jax.lax.dynamic_update_slice_in_dim(total, head, 0, axis=0)
        if self.extra is not None:
            total = total.at[self.extra[1]].add(source[self.extra[0]])
        if self.empty:
            total = jnp.concatenate([total, jnp.zeros((self.empty, *total.shape[1:]))])
        return total[self.order]


class Dependent(eqx.Module):
    """Where nodes are whose degrees of freedom are no unknowns: see `jaxshell.assembly.elimination`."""

    followers: Int[Array, " k"]
    masters: Int[Array, " k"]
    """Of the followers."""
    turned: Int[Array, " s"]
    """Nodes with axes of their own, and the followers of such."""
    touched: Int[Array, " t"]
    """Elements with any of these nodes."""
    entries: Int[Array, " e"]
    """Of a (6, 6) matrix for each follower, entry by entry: its place in the sparse matrix, at its master."""


class Tables(eqx.Module):
    """Index arrays of one structure (connectivity, held degrees of freedom), arguments of the compiled programs."""

    triangles: Int[Array, "m 3"]
    nodal: GatherSum
    """(m·3, ...) element corners → (n, ...) nodes."""
    matrix: GatherSum
    """(m·324,) element matrix entries → values of the sparse matrix over the free ones; empty without one."""
    free: Int[Array, " nf"]
    """Numbers 6·node + dof of the free degrees of freedom."""
    held: Int[Array, " nh"]
    place: Int[Array, " n6"]
    """Where each degree of freedom stands in [free, held]."""
    groups: tuple[Int[Array, "_ _"], ...] = ()
    """Nodes of the contributions' groups, other than the elements' own."""
    entries: tuple[Int[Array, " _"], ...] = ()
    """Of the groups' matrices, entry by entry: its place in the sparse matrix; beyond its end where it has none."""
    own: Int[Array, " nnz"] | None = None
    """Of every entry of the sparse matrix, its place in `matrix`, one past the end where only groups have it; None
    where `matrix` is the sparse matrix."""
    dependent: Dependent | None = None
    """None where every node's own degrees of freedom are unknown or held."""
    nodes: int = eqx.field(static=True, default=0)
    """How many the mesh has; the rest hold multipliers."""
    supported: int = eqx.field(static=True, default=0)
    """How many of the held degrees of freedom, the first, are the supports'."""
    multipliers: int = eqx.field(static=True, default=0)
    """How many nodes, the last, are not the mesh's."""
    adrift: tuple[int, ...] = eqx.field(static=True, default=())
    """The axes x, y, z (0, 1, 2) along which no support holds the shell."""
    zeros: Int[Array, " q"] | None = None
    """Places of the diagonal entries of the multipliers in the sparse matrix; None where there are none."""
    constrained: Int[Array, " q"] | None = None
    """Those unknowns that are multipliers."""


class Structure(NamedTuple):
    """Static: what the sparsity depends on."""

    triangles: Frozen
    n_nodes: int
    held: Frozen
    groups: tuple[Frozen, ...] = ()
    """(k, c) nodes of the contributions' groups, other than the elements' own."""
    masters: Frozen | None = None
    """(n,) the node whose degrees of freedom move a node: itself, or the reference of its rigid body."""
    turned: Frozen | None = None
    """Nodes with axes of their own, and the followers of such."""
    multipliers: int = 0
    """How many of the nodes, the last, are not the mesh's and hold multipliers."""
    supported: int = 0
    """How many of the held degrees of freedom, the first, are the supports'."""

    @property
    def followers(self) -> np.ndarray:
        """Nodes that follow another."""
        if self.masters is None:
            return np.zeros(0, np.int64)
        return np.flatnonzero(self.masters.array != np.arange(self.n_nodes))

    def numbers(self) -> np.ndarray:
        """(6·n,) the unknown that each degree of freedom goes with; negative where it is held."""
        free = _free_dofs(self)
        number = np.full(6 * self.n_nodes, -1)
        number[free] = np.arange(free.size)
        return number if self.masters is None else number.reshape(-1, 6)[self.masters.array].ravel()


@functools.lru_cache(maxsize=32)
def analyse(structure: Structure) -> tuple[Tables, SparsityPattern]:
    """Tables and sparsity pattern of a structure; done once, kept for later runs of the same structure."""
    triangles, free = structure.triangles.array, _free_dofs(structure)
    number = structure.numbers()
    own, sources = _keys(triangles, number, free.size)
    groups = [group.array for group in structure.groups]
    if structure.followers.size:
        groups.append(structure.followers[:, None])
    others = [_keys(group, number, free.size) for group in groups]
    mine, targets = np.unique(own[sources], return_inverse=True)
    entries = mine
    if others or not np.isin(free // 6, triangles).all():
        diagonal = np.arange(free.size) * (free.size + 1)
        entries = np.unique(np.concatenate([mine, diagonal, *(keys[kept] for keys, kept in others)]))
    indptr = np.concatenate([[0], np.cumsum(np.bincount(entries // free.size, minlength=free.size))])
    pattern = SparsityPattern(free.size, Frozen(indptr), Frozen(entries % free.size))
    with jax.ensure_compile_time_eval():
        matrix = GatherSum.build(targets.ravel(), sources, mine.size)
        own_places = np.full(entries.size, mine.size)
        own_places[np.searchsorted(entries, mine)] = np.arange(mine.size)
        spread = None if entries.size == mine.size else index_array(own_places)
        places = tuple(
            index_array(np.where(keys >= 0, np.searchsorted(entries, keys), entries.size)) for keys, _ in others
        )
    tables = nodal_tables(structure)
    if tables.dependent is not None and structure.followers.size:
        *places, own_block = places
        tables = eqx.tree_at(lambda t: t.dependent.entries, tables, own_block)
    zeros = constrained = None
    if structure.multipliers:
        numbers = np.flatnonzero(free // 6 >= structure.n_nodes - structure.multipliers)
        with jax.ensure_compile_time_eval():
            constrained = index_array(numbers)
            zeros = index_array(np.searchsorted(entries, numbers * (free.size + 1)))
    changed = {"matrix": matrix, "entries": tuple(places), "own": spread, "zeros": zeros, "constrained": constrained}
    return dataclasses.replace(tables, **changed), pattern


def _keys(nodes: np.ndarray, number: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """row·size + column of every entry of the matrices of groups (k, c), negative where it is of a held one; and the
    positions of those that are not."""
    width = 6 * nodes.shape[1]
    dofs = number[(6 * nodes[:, :, None] + np.arange(6)).reshape(len(nodes), width)]
    rows = np.repeat(dofs, width, axis=1).ravel()
    columns = np.tile(dofs, (1, width)).ravel()
    free = (rows >= 0) & (columns >= 0)
    return np.where(free, rows.astype(np.int64) * size + columns, -1), np.flatnonzero(free)


@functools.lru_cache(maxsize=32)
def nodal_tables(structure: Structure) -> Tables:
    """Tables of a structure without those of the matrix, which an explicit method has no use for."""
    triangles, held, free = structure.triangles.array, structure.held.array, _free_dofs(structure)
    place = np.empty(6 * structure.n_nodes, np.int64)
    place[free], place[held] = np.arange(free.size), free.size + np.arange(held.size)
    if structure.masters is not None:
        place = place.reshape(-1, 6)[structure.masters.array].ravel()
    # Concrete also while an outer transformation traces: tables are data, never part of the traced program.
    with jax.ensure_compile_time_eval():
        corners = triangles.ravel()
        return Tables(
            index_array(triangles),
            GatherSum.build(corners, np.arange(corners.size), structure.n_nodes),
            GatherSum((), index_array(np.zeros(0)), None),
            index_array(free),
            index_array(held),
            index_array(place),
            tuple(index_array(group.array) for group in structure.groups),
            dependent=_dependent(structure),
            nodes=structure.n_nodes - structure.multipliers,
            supported=structure.supported,
            multipliers=structure.multipliers,
            adrift=_adrift(structure),
        )


def _adrift(structure: Structure) -> tuple[int, ...]:
    if structure.turned is not None:
        return ()
    held = structure.held.array
    of_mesh = held[held < 6 * (structure.n_nodes - structure.multipliers)]
    return tuple(sorted({0, 1, 2} - set((of_mesh % 6).tolist())))


def _dependent(structure: Structure) -> Dependent | None:
    if structure.masters is None and structure.turned is None:
        return None
    followers = structure.followers
    masters = np.zeros(0, np.int64) if structure.masters is None else structure.masters.array[followers]
    turned = np.zeros(0, np.int64) if structure.turned is None else structure.turned.array
    touched = np.isin(structure.triangles.array, np.concatenate([followers, turned])).any(axis=1)
    none = np.zeros(0, np.int64)
    return Dependent(*(index_array(a) for a in (followers, masters, turned, np.flatnonzero(touched), none)))


def _free_dofs(structure: Structure) -> np.ndarray:
    is_free = np.ones(6 * structure.n_nodes, bool)
    is_free[structure.held.array] = False
    if structure.masters is not None:
        is_free.reshape(-1, 6)[structure.followers] = False
    free = np.flatnonzero(is_free)
    if free.size == 0:
        raise ValueError("Every degree of freedom is held by a support: there is nothing to compute.")
    return free
