"""First-order sensitivities: how much of a response's variance each parameter explains.

The design decides what can be estimated:

    grid                    S_i = Var(E[y | x_i]) / Var(y) over the grid's values, each as likely as another: exact for
                            the grid (the main effects of an analysis of variance).
    random, latin, sobol    standardised regression coefficients β_i of y = β_0 + Σ β_i x_i, both in units of their
    and zip                 deviations. β_i² is S_i as far as y is linear and the parameters are independent; R² says
                            how linear it is.
    saltelli                Sobol's first-order indices S_i, and the total ones (Saltelli et al. 2010), without any
                            assumption on y; from the base points of which no member failed.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

MAIN, REGRESSION, SOBOL = "main effects", "regression", "Sobol"
_RANK = 1e-8
"""Singular values of the standardised parameters below this fraction of the largest mean that some go together."""


@dataclasses.dataclass(frozen=True)
class Sensitivities:
    """Of each response, p numbers for the p parameters. NaN for a response that does not vary."""

    estimate: str
    """What `values` are: "main effects" (S_i), "regression" (β_i, signed) or "Sobol" (S_i)."""
    parameters: tuple[str, ...]
    values: dict[str, np.ndarray]
    """{response: (p,)}."""
    total: dict[str, np.ndarray] | None = None
    """{response: (p,)} Sobol's total indices, of a saltelli design."""
    r_squared: dict[str, float] | None = None
    """{response: R²}, of a regression."""
    members: int = 0
    """Members that it was estimated from."""


def sensitivities_of(
    kind: str, parameters: Mapping[str, np.ndarray], responses: Mapping[str, np.ndarray], usable: np.ndarray
) -> Sensitivities:
    """Of responses (N,) of the members that are `usable` (N,), by the estimate that the design `kind` allows.

    Raises ValueError where it allows none.
    """
    several = {name: values for name, values in parameters.items() if values.ndim != 1}
    if several:
        raise ValueError(f"Sensitivities are to single numbers, but {next(iter(several))} has several per member.")
    if kind == "saltelli":
        return _sobol(parameters, responses, usable)
    usable = usable & np.all([np.isfinite(values) for values in responses.values()], axis=0)
    if usable.sum() < len(parameters) + 2:
        raise ValueError(
            f"{int(usable.sum())} members that ended successfully are too few for the sensitivities to "
            f"{len(parameters)} parameters; {len(parameters) + 2} are the least."
        )
    if kind == "grid":
        return _main_effects(parameters, responses, usable)
    return _regression(parameters, responses, usable)


def _main_effects(parameters, responses, usable) -> Sensitivities:
    values = {}
    for name, y in responses.items():
        y = y[usable]
        values[name] = np.array([_explained(x[usable], y) for x in parameters.values()])
    return Sensitivities(MAIN, tuple(parameters), values, members=int(usable.sum()))


def _explained(x: np.ndarray, y: np.ndarray) -> float:
    """Var(E[y | x]) / Var(y)."""
    if not _varies(y):
        return np.nan
    _, group, sizes = np.unique(x, return_inverse=True, return_counts=True)
    means = np.bincount(group, y) / sizes
    return float(sizes @ (means - y.mean()) ** 2 / len(y) / y.var())


def _regression(parameters, responses, usable) -> Sensitivities:
    texts = [name for name, x in parameters.items() if x.dtype.kind not in "fiu"]
    if texts:
        raise ValueError(f"A regression needs numbers, but {texts[0]} has texts: vary it in a grid.")
    columns = []
    for name, x in parameters.items():
        x = np.asarray(x[usable], float)
        if not _varies(x):
            raise ValueError(f"{name} has one value in all members: nothing can be said of its influence.")
        columns.append((x - x.mean()) / x.std())
    X = np.stack(columns, axis=1)
    sizes = np.linalg.svd(X, compute_uv=False)
    if sizes[-1] < _RANK * sizes[0]:
        raise ValueError(
            f"{', '.join(parameters)} go together in this design, so that their influence cannot be told apart. "
            "Use a grid or a sample."
        )
    values, r_squared = {}, {}
    for name, y in responses.items():
        y = y[usable]
        if not _varies(y):
            values[name], r_squared[name] = np.full(X.shape[1], np.nan), float("nan")
            continue
        z = (y - y.mean()) / y.std()
        values[name] = np.linalg.lstsq(X, z, rcond=None)[0]
        r_squared[name] = float(1 - np.mean((z - X @ values[name]) ** 2))
    return Sensitivities(REGRESSION, tuple(parameters), values, r_squared=r_squared, members=int(usable.sum()))


def _sobol(parameters, responses, usable) -> Sensitivities:
    """The estimators of Saltelli et al. 2010, Table 2 (b) and (f), as `scipy.stats.sobol_indices` has them; that takes
    a power of two of base points only, which failed members leave no more."""
    width = len(parameters)
    count = len(usable) // (width + 2)
    rows = usable & np.all([np.isfinite(y) for y in responses.values()], axis=0)
    kept = rows.reshape(width + 2, count).all(axis=0)
    if kept.sum() < 2:
        raise ValueError(f"{kept.sum()} of {count} base points have all their members: too few for Sobol indices.")
    values, total = {}, {}
    for name, y in responses.items():
        table = y.reshape(width + 2, count)[:, kept]
        if not _varies(table):
            values[name] = total[name] = np.full(width, np.nan)
            continue
        f_A, f_B, *f_AB = table - table[:2].mean()
        variance = np.var(table[:2])
        values[name] = np.array([np.mean(f_B * (mixed - f_A)) for mixed in f_AB]) / variance
        total[name] = np.array([np.mean((f_A - mixed) ** 2) / 2 for mixed in f_AB]) / variance
    return Sensitivities(SOBOL, tuple(parameters), values, total, members=(width + 2) * int(kept.sum()))


def _varies(y: np.ndarray) -> bool:
    """Whether a response is more than one number and its round-off."""
    return bool(np.ptp(y) > 1e-12 * np.abs(y).max())
