"""Checks that materials share."""

import numpy as np

from jaxshell.numerics.checks import check_finite, check_positive, check_shape, is_concrete


def check_scalar(name: str, value) -> None:
    """Raise ValueError unless `value` is one finite number."""
    check_shape(name, value, ())
    check_finite(name, value)


def check_modulus(name: str, value) -> None:
    """Raise ValueError unless `value` is one positive number."""
    check_shape(name, value, ())
    check_positive(name, value)


def check_poisson_ratio(value) -> None:
    """Raise ValueError for a known ν outside (-1, 1/2], that of any element."""
    check_finite("poisson_ratio", value)
    if is_concrete(value):
        ratio = np.asarray(value)
        bad = (ratio <= -1) | (ratio > 0.5)
        if bad.any():
            raise ValueError(f"poisson_ratio must lie in (-1, 0.5], but it is {ratio[bad].flat[0]}.")
