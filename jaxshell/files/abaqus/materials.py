"""*MATERIAL and what stands under it, as a table [materials.NAME] of a scene file."""

from dataclasses import dataclass, field
from typing import Any

from jaxshell.files.draft import Notes
from jaxshell.model.mesh_files.cards import Card


@dataclass
class Material:
    """A material of the file."""

    name: str
    where: str
    values: dict[str, Any] = field(default_factory=dict)
    """The keys of [materials.NAME]."""
    damping: dict[str, float] = field(default_factory=dict)
    """alpha and beta of *DAMPING."""

    @property
    def is_isotropic(self) -> bool:
        return "young_modulus" in self.values

    def table(self, statics: bool, notes: Notes) -> dict[str, Any]:
        """Its table. Statics without a density get 1, and a note. Raises ValueError where the material lacks what a
        shell needs."""
        if not self.is_isotropic and "young_modulus_1" not in self.values:
            raise ValueError(f"{self.where}: material {self.name} has no *ELASTIC.")
        if "density" not in self.values:
            if not statics:
                raise ValueError(f"{self.where}: material {self.name} has no *DENSITY, which motion needs.")
            notes.remarks.append(f"material {self.name} ({self.where}) has no *DENSITY: 1.0 stands in its place")
            self.values["density"] = 1.0
        return self.values


IN_MATERIALS = ("ELASTIC", "DENSITY", "EXPANSION", "DAMPING")
_BEYOND = (
    "PLASTIC",
    "HYPERELASTIC",
    "HYPERFOAM",
    "HYPOELASTIC",
    "VISCOELASTIC",
    "CREEP",
    "VISCOUS",
    "CYCLICHARDENING",
    "DAMAGEINITIATION",
    "DAMAGEEVOLUTION",
    "USERMATERIAL",
    "DEFORMATIONPLASTICITY",
    "NOCOMPRESSION",
    "NOTENSION",
)
"""Behaviour of a material that is not linear."""


def is_beyond(card: Card) -> bool:
    """Whether the card makes a material what jaxshell has not."""
    return card.keyword in _BEYOND


def add(material: Material, card: Card, notes: Notes) -> None:
    """What a card of IN_MATERIALS says of the material. Raises ValueError for numbers that are missing."""
    {"ELASTIC": _elastic, "DENSITY": _density, "EXPANSION": _expansion, "DAMPING": _damping}[card.keyword](
        material, card, notes
    )


def _elastic(material: Material, card: Card, notes: Notes) -> None:
    kind = card.choice("TYPE", "ISOTROPIC")
    keys = {
        "ISOTROPIC": ("young_modulus", "poisson_ratio"),
        "ISO": ("young_modulus", "poisson_ratio"),
        "LAMINA": ("young_modulus_1", "young_modulus_2", "poisson_ratio_12", "shear_modulus_12"),
        # E1, E2, E3, ν12, ν13, ν23, G12, ...: in plane stress the third direction has no part.
        "ENGINEERINGCONSTANTS": (
            "young_modulus_1",
            "young_modulus_2",
            "",
            "poisson_ratio_12",
            "",
            "",
            "shear_modulus_12",
        ),
    }.get("".join(kind.split()))
    if keys is None:
        raise ValueError(
            f"{card.where}: *ELASTIC, TYPE={kind} is not read; ISOTROPIC, LAMINA and ENGINEERING CONSTANTS are."
        )
    one_line = len(card.lines) == 1 or (len(keys) == 7 and len(card.lines) == 2)
    if not one_line and card.lines:
        notes.missing.append(f"*ELASTIC of material {material.name} ({card.where}): constants beyond the first line")
    line = card.line(0)
    material.values.update({key: line.number(position) for position, key in enumerate(keys) if key})


def _density(material: Material, card: Card, notes: Notes) -> None:
    material.values["density"] = card.line(0).number(0)
    _constant(material, card, notes)


def _expansion(material: Material, card: Card, notes: Notes) -> None:
    kind = card.choice("TYPE", "ISO")
    if kind not in ("ISO", "ORTHO"):
        raise ValueError(f"{card.where}: *EXPANSION, TYPE={kind} is not read; ISO and ORTHO are.")
    line = card.line(0)
    if kind == "ISO":
        material.values["expansion"] = line.number(0)
    else:
        material.values.update({"expansion_1": line.number(0), "expansion_2": line.number(1)})
    _constant(material, card, notes)


def expansion_fits(values: dict[str, Any]) -> dict[str, Any]:
    """The values with one expansion written as two where the material has directions."""
    if "young_modulus_1" in values and "expansion" in values:
        rest = {key: value for key, value in values.items() if key != "expansion"}
        return {**rest, "expansion_1": values["expansion"], "expansion_2": values["expansion"]}
    if "young_modulus" in values and "expansion_1" in values:
        raise ValueError("An isotropic material expands alike in all directions: *EXPANSION, TYPE=ORTHO needs LAMINA.")
    return values


def _constant(material: Material, card: Card, notes: Notes) -> None:
    if len(card.lines) > 1:
        notes.missing.append(f"{card.title} of material {material.name} ({card.where}): values beyond the first line")


def _damping(material: Material, card: Card, notes: Notes) -> None:
    for key in card.options:
        if key in ("ALPHA", "BETA"):
            material.damping[key.lower()] = card.value(key)
        else:
            notes.missing.append(f"*DAMPING, {key} of material {material.name} ({card.where})")
