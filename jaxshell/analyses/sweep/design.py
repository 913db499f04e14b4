"""Which members a sweep has: all combinations, values side by side, or a sample.

    grid         every combination of all levels, the last parameter running fastest
    zip          the first values together, the second ones, ...
    random:N     N independent draws
    latin:N      a latin hypercube: each parameter's N strata of equal probability hold one member each
    sobol:N      a scrambled Sobol sequence, N a power of two
    saltelli:N   N (d + 2) members for d parameters, from which Sobol indices are estimated (Saltelli et al. 2010)

Samples come from `scipy.stats.qmc`; the same seed gives the same members.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxshell.analyses.sweep.varied import LARGEST_SWEEP, Varied
from jaxshell.numerics.checks import check_count, shown

_SAMPLES = ("random", "latin", "sobol", "saltelli")
KINDS = ("grid", "zip", *(f"{kind}:N" for kind in _SAMPLES))


class Design(NamedTuple):
    """The members of a sweep."""

    kind: str
    """One out of grid, zip, random, latin, sobol, saltelli."""
    parameters: dict[str, np.ndarray]
    """{name: (N, ...)}, a value per member."""

    @property
    def size(self) -> int:
        return len(next(iter(self.parameters.values())))

    def member(self, number: int) -> dict[str, Any]:
        """{name: value} of one member."""
        return {name: values[number] for name, values in self.parameters.items()}


def design(vary: Mapping[str, Varied], sample: str = "grid", seed: int = 0) -> Design:
    """The members that `vary` and `sample` (a text as above) make.

    Raises ValueError for a sample that is none of these or lacks its N, for more than a million members, and for
    parameters that it cannot take.
    """
    if not vary:
        raise ValueError("Nothing varies: name at least one parameter and its values.")
    kind, count = _read(sample)
    check_count("seed", seed, least=0)
    if kind in _SAMPLES:
        total = count * (len(vary) + 2) if kind == "saltelli" else count
        _check_size(total)
        if kind == "saltelli" and len(vary) < 2:
            raise ValueError("saltelli tells parameters apart, and one alone explains everything: use latin or sobol.")
        fractions = _fractions(kind, count, len(vary), seed)
        return Design(kind, {name: axis.at(fractions[:, j]) for j, (name, axis) in enumerate(vary.items())})
    levels = {name: axis.all_levels(name) for name, axis in vary.items()}
    sizes = [len(values) for values in levels.values()]
    if kind == "zip":
        _check_size(max(sizes))
        if len(set(sizes)) > 1:
            said = ", ".join(f"{name} has {size}" for name, size in zip(levels, sizes, strict=True))
            raise ValueError(f"zip wants as many values of every parameter, but {said}.")
        return Design(kind, levels)
    _check_size(math.prod(sizes))
    places = np.indices(sizes).reshape(len(sizes), -1)
    return Design(kind, {name: values[at] for (name, values), at in zip(levels.items(), places, strict=True)})


def _read(sample: str) -> tuple[str, int]:
    kind, _, number = sample.partition(":") if isinstance(sample, str) else ("", "", "")
    if kind in ("grid", "zip") and not number:
        return kind, 0
    if kind not in _SAMPLES:
        raise ValueError(f"A sample is one of {', '.join(KINDS)}, but it is {shown(sample)}.")
    if not number.isdecimal() or int(number) < 1:
        raise ValueError(f"{kind} needs the number of its members, such as {kind}:128, but it is {sample!r}.")
    count = int(number)
    if kind in ("sobol", "saltelli") and count & (count - 1):
        below = 1 << (count.bit_length() - 1)
        raise ValueError(f"{kind} wants a power of two: {kind}:{below} or {kind}:{2 * below}, but it is {sample!r}.")
    return kind, count


def _check_size(count: int) -> None:
    if count > LARGEST_SWEEP:
        raise ValueError(f"The sweep has {count:,} members, and at most {LARGEST_SWEEP:,} are taken.")


def _fractions(kind: str, count: int, width: int, seed: int) -> np.ndarray:
    """(N, width) points of the unit cube, none of them on its border, where many distributions are infinite."""
    from scipy.stats import qmc

    if kind == "random":
        return _inside(np.random.default_rng(seed).random((count, width)))
    if kind == "latin":
        return _inside(qmc.LatinHypercube(width, rng=np.random.default_rng(seed)).random(count))
    if kind == "sobol":
        return _inside(qmc.Sobol(width, rng=np.random.default_rng(seed)).random(count))
    both = _inside(qmc.Sobol(2 * width, rng=np.random.default_rng(seed)).random(count))
    A, B = both[:, :width], both[:, width:]
    mixed = np.repeat(A[None], width, axis=0)
    for j in range(width):
        mixed[j, :, j] = B[:, j]
    return np.concatenate([A, B, *mixed])


def _inside(points: np.ndarray) -> np.ndarray:
    return np.clip(points, 2.0**-53, 1 - 2.0**-53)
