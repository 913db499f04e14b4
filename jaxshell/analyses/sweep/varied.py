"""What one parameter of a sweep runs through: levels, a span between two ends, or a distribution.

As text, on the command line and in Python:

    0.3:0.5:20                 20 values from 0.3 to 0.5, both ends included; in a sample uniform between the ends
    0.3:0.5                    uniform between the ends (samples only)
    0.3,0.4,0.5                these values; in a sample each equally likely
    EMC,exact                  texts, where the key holds a text
    uniform(0.3, 0.5)          distributions (samples only): normal(mean, deviation), lognormal(mean, deviation),
                               triangular(low, mode, high), truncated(mean, deviation, low, high)
    x0.9:1.1:5, xnormal(1, 0.02)   the same as factors of the value in the scene file
"""

import dataclasses
import math
import re
from typing import Any

import numpy as np

from jaxshell.numerics.checks import shown

LARGEST_SWEEP = 1_000_000
"""Members that a sweep may have."""
_CALL = re.compile(r"(\w+)\s*\((.*)\)")


@dataclasses.dataclass(frozen=True)
class Varied:
    """One parameter's values.

    Exactly one of `levels` (k, ...), `span` (low, high) with `count` values or None, and `distribution` (an object with
    a method `ppf`, such as scipy.stats.norm(0.4, 0.02)) is given.
    """

    text: str
    """As it was stated, for messages and the file."""
    levels: np.ndarray | None = None
    span: tuple[float, float] | None = None
    count: int | None = None
    distribution: Any = None
    factor: bool = False
    """Whether the values multiply what the scene file says."""

    def all_levels(self, name: str) -> np.ndarray:
        """Its values, for a grid. Raises ValueError where it has none of its own."""
        if self.levels is not None:
            return self.levels
        if self.span is not None and self.count is not None:
            return np.linspace(*self.span, self.count)
        raise ValueError(
            f"{name}: {self.text} has no values of its own. Say how it is sampled, such as latin:200, or give "
            "a range with its number of values, low:high:n."
        )

    def at(self, fraction: np.ndarray) -> np.ndarray:
        """Values at fractions in [0, 1) of its probability."""
        if self.distribution is not None:
            return np.asarray(self.distribution.ppf(fraction), float)
        if self.span is not None:
            low, high = self.span
            return low + (high - low) * fraction
        assert self.levels is not None
        return self.levels[np.minimum((fraction * len(self.levels)).astype(int), len(self.levels) - 1)]


def varied(name: str, given) -> Varied:
    """What `name` runs through: a text as above, a sequence or array of values, or a distribution of scipy.stats.

    Raises ValueError naming the parameter for anything else.
    """
    if isinstance(given, Varied):
        return given
    if isinstance(given, str):
        return _read(name, given.strip())
    if callable(getattr(given, "ppf", None)):
        return Varied(_named(given), distribution=given)
    try:
        levels = np.asarray(given)
    except (TypeError, ValueError):
        levels = np.asarray(None)
    if levels.ndim == 0 or not len(levels) or levels.dtype.kind not in "fiuU":
        raise ValueError(
            f"{name} must be a list of values, a range such as '0.3:0.5:20' or a distribution of scipy.stats, but it "
            f"is {shown(given)}."
        )
    if levels.dtype.kind == "f" and not np.isfinite(levels).all():
        raise ValueError(f"{name} has a value that is not finite: {shown(given)}.")
    return Varied(shown(levels.tolist()), levels=levels)


def _read(name: str, text: str) -> Varied:
    factor = re.match(r"x\s*([-+.\d]|\w+\s*\()", text) is not None
    body = text[1:].strip() if factor else text
    called = _CALL.fullmatch(body)
    if called:
        return Varied(text, distribution=_distribution(name, called[1], called[2]), factor=factor)
    if ":" in body:
        return Varied(text, **_range(name, body), factor=factor)
    entries = [entry.strip() for entry in body.split(",")]
    if not all(entries):
        raise ValueError(f"{name}: {text!r} has an empty value; write values as 0.3,0.4,0.5.")
    numbers = [_number(entry) for entry in entries]
    if all(number is not None for number in numbers):
        return Varied(text, levels=np.asarray(numbers, float), factor=factor)
    if factor or any(number is not None for number in numbers):
        raise ValueError(f"{name}: {text!r} mixes numbers with texts; write values as 0.3,0.4,0.5.")
    return Varied(text, levels=np.asarray(entries))


def _range(name: str, text: str) -> dict[str, Any]:
    pieces = text.split(":")
    ends = [_number(piece) for piece in pieces[:2]]
    if len(pieces) not in (2, 3) or None in ends:
        raise ValueError(f"{name}: a range is low:high:n or low:high, but it is {text!r}.")
    if len(pieces) == 2:
        return {"span": tuple(ends)}
    try:
        count = int(pieces[2])
    except ValueError:
        raise ValueError(f"{name}: the n of a range low:high:n is a whole number, but it is {pieces[2]!r}.") from None
    if count < 1:
        raise ValueError(f"{name}: a range has at least 1 value, but {text!r} asks for {count}.")
    if count > LARGEST_SWEEP:
        raise ValueError(f"{name}: {text!r} asks for more than the {LARGEST_SWEEP:,} members that a sweep may have.")
    if count == 1 and ends[0] != ends[1]:
        raise ValueError(f"{name}: {text!r} asks for 1 value between two ends; write the value alone.")
    return {"span": tuple(ends), "count": count}


def _number(text: str) -> float | None:
    """A finite number, or None."""
    try:
        found = float(text)
    except ValueError:
        return None
    return found if math.isfinite(found) else None


def _distribution(name: str, kind: str, inside: str) -> Any:
    if kind not in _DISTRIBUTIONS:
        raise ValueError(f"{name}: there is no distribution {kind!r}. Choose out of {', '.join(_DISTRIBUTIONS)}.")
    words, make = _DISTRIBUTIONS[kind]
    numbers = [found for piece in inside.split(",") if (found := _number(piece)) is not None]
    if len(numbers) != len(words) or inside.count(",") != len(words) - 1:
        raise ValueError(f"{name}: write {kind}({', '.join(words)}) with numbers, but it is {kind}({inside}).")
    said = dict(zip(words, numbers, strict=True))
    low, high = said.get("low", -math.inf), said.get("high", math.inf)
    if not low < high or not low <= said.get("mode", low) <= high or not said.get("deviation", 1.0) > 0:
        raise ValueError(
            f"{name}: {kind}({inside}) needs low < high, a mode between them and a positive deviation, as far as it "
            "has them."
        )
    if kind == "lognormal" and said["mean"] <= 0:
        raise ValueError(f"{name}: the mean of a lognormal is positive, but it is {said['mean']:g}.")
    return make(*numbers)


def _uniform(low, high):
    from scipy import stats

    return stats.uniform(low, high - low)


def _normal(mean, deviation):
    from scipy import stats

    return stats.norm(mean, deviation)


def _lognormal(mean, deviation):
    """Of the given mean and standard deviation (not those of its logarithm)."""
    from scipy import stats

    variance = math.log1p((deviation / mean) ** 2)
    return stats.lognorm(math.sqrt(variance), scale=mean * math.exp(-variance / 2))


def _triangular(low, mode, high):
    from scipy import stats

    return stats.triang((mode - low) / (high - low), low, high - low)


def _truncated(mean, deviation, low, high):
    from scipy import stats

    return stats.truncnorm((low - mean) / deviation, (high - mean) / deviation, mean, deviation)


_DISTRIBUTIONS: dict[str, tuple[tuple[str, ...], Any]] = {
    "uniform": (("low", "high"), _uniform),
    "normal": (("mean", "deviation"), _normal),
    "lognormal": (("mean", "deviation"), _lognormal),
    "triangular": (("low", "mode", "high"), _triangular),
    "truncated": (("mean", "deviation", "low", "high"), _truncated),
}
"""{name: (its arguments' names, what makes it)}."""


def _named(distribution) -> str:
    """A frozen distribution of scipy.stats as text."""
    name = getattr(getattr(distribution, "dist", None), "name", type(distribution).__name__)
    given = [*map(repr, getattr(distribution, "args", ()))]
    given += [f"{key}={value!r}" for key, value in getattr(distribution, "kwds", {}).items()]
    return f"{name}({', '.join(given)})"
