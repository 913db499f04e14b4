"""Short names of time integrators, as the command line, scene files and legends use them.

EMC, EDMC1 and EDMC2 are the paper's (Yang & Xia 2014, section VI): `GeneralizedEnergyMomentum` with the
spectral radius ρ∞ and dissipation ξ that the scene gives them; "exact" is `EnergyMomentum`. Every other
method goes by its class's name.
"""

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

from jaxshell import methods
from jaxshell.files.quoted import unquote
from jaxshell.model.scene import Scene
from jaxshell.numerics.nearest import meant

_PAPER_CLASS: Any = methods.GeneralizedEnergyMomentum
_PAPER = (("EMC", 1.0, 0.0), ("EDMC1", 0.8, 0.0), ("EDMC2", 1.0, 0.05))
"""(name, ρ∞, ξ) where a scene does not say otherwise: those of the paper's first scene."""


_EXACT = "exact"
_CLASS_OF_EXACT: dict[str, str] = {"energymomentum": _EXACT}


def choose_methods(scene: Scene, names: Sequence[str], parameters: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """{label: method} for names such as ["EMC", "exact"], or ["all"] for all of the paper's.

    No name is the scene's first. `parameters` replace the names' own; numbers among them for one method only. Raises
    ValueError for an unknown name, and for parameters that a method does not have.
    """
    named, classes, given = _named(scene), _classes(), dict(parameters or {})
    wanted = [_CLASS_OF_EXACT.get(name.lower(), name.lower()) for name in names] or [next(iter(named))]
    for name in wanted:
        if name not in named and name not in classes and name != "all":
            others = [_written(kind) for kind in classes.values() if kind is not _PAPER_CLASS]
            choices = [label for label, _, _ in named.values()] + others + ["all"]
            asked = next(given for given in names if given.lower() == name)
            raise ValueError(f"There is no method {asked!r}.{meant(name, choices)} Choose out of {', '.join(choices)}.")
    wanted = list(named) if "all" in wanted else list(dict.fromkeys(wanted))
    numbers = [key for key, value in given.items() if not isinstance(value, str)]
    if len(wanted) > 1 and numbers:
        raise ValueError(f"{numbers[0]} can be given for one method at a time.")
    found = {}
    for name in wanted:
        if name in named:
            written, radius, xi = named[name]
            kind, own = _PAPER_CLASS, {"spectral_radius": radius, "dissipation": xi}
        else:
            kind, own, written = classes[name], {}, _written(classes[name])
        for key in given:
            if key not in kind.__dataclass_fields__:
                raise ValueError(f"The method {written!r} has no {key}.")
        method = kind(**own | given)
        found[method_label(method, scene)] = method
    return found


def method_label(method: methods.Method, scene: Scene) -> str:
    """The short name of a method in a scene, or its class with the parameters that matter."""
    kind = type(method).__name__
    xi = float(getattr(method, "dissipation", 0.0))
    if kind == "EnergyMomentum":
        return f"{_EXACT}, ξ = {xi:g}" if xi else _EXACT
    if kind != "GeneralizedEnergyMomentum":
        return kind
    radius = float(getattr(method, "spectral_radius", 1.0))
    for label, *parameters in _named(scene).values():
        if parameters == [radius, xi]:
            return label
    return f"EDMC, ρ∞ = {radius:g}, ξ = {xi:g}"


def parse_method(text: str) -> methods.Method:
    """The method that a file quotes, such as "GeneralizedEnergyMomentum(spectral_radius=1.0, ...)".

    Raises ValueError for anything else.
    """
    return unquote(text, {method.__name__: method for method in _classes().values()})


def _written(kind: type) -> str:
    """A class's name as one writes it."""
    return _CLASS_OF_EXACT.get(kind.__name__.lower(), kind.__name__)


def _named(scene: Scene) -> dict[str, tuple[str, float, float]]:
    """{lower-case name: (label, ρ∞, ξ)}, the scene's own first."""
    own = scene.defaults.methods if scene.defaults is not None else ()
    named = {label.lower(): (label, float(radius), float(xi)) for label, radius, xi in own}
    return named | {label.lower(): (label, r, xi) for label, r, xi in _PAPER if label.lower() not in named}


def _classes() -> dict[str, Any]:
    """{lower-case name: class} of the methods that can be made."""
    found = [getattr(methods, name) for name in methods.__all__]
    classes = {kind.__name__.lower(): kind for kind in found if not inspect.isabstract(kind)}
    if "energymomentum" in classes:
        classes[_EXACT] = classes.pop("energymomentum")
    return classes
