"""PSHELL, PCOMP and PCOMPG with MAT1 and MAT8, as tables [section] or [[section]] and [materials.X] of a scene file."""

from typing import Any

import numpy as np

from jaxshell.files.draft import Notes
from jaxshell.files.nastran.control import Deck
from jaxshell.files.nastran.geometry import Element, Geometry
from jaxshell.model.mesh_files.bulk_data import Card

PROPERTIES = ("PSHELL", "PCOMP", "PCOMPG")
MATERIALS = ("MAT1", "MAT8")
_ISOTROPIC = 1e-3
"""G may differ from E/2(1+ν) by this fraction: MAT1 is often written with few digits."""


class Sections:
    """The sections of a file. `mass` is PARAM,WTMASS, by which Nastran multiplies every density; `statics` says whether
    densities may be missing."""

    def __init__(self, deck: Deck, geometry: Geometry, notes: Notes, mass: float, statics: bool):
        self._geometry, self._notes, self._mass, self._statics = geometry, notes, mass, statics
        self._properties = {card.whole(1): card for card in deck.named(*PROPERTIES)}
        self._materials = {card.whole(1): card for card in deck.named("MAT1", "MAT2", "MAT8", "MAT9", "MAT10")}
        self._used: dict[str, dict[str, Any]] = {}
        self._unweighed: set[int] = set()

    def tables(self) -> dict[str, Any]:
        """[section] or [[section]], and [materials.X]. Raises ValueError for what is missing."""
        groups: dict[tuple, list[Element]] = {}
        for element in self._geometry.elements:
            if element.section not in self._properties:
                raise ValueError(
                    f"{element.card.where}: element {element.label} names property {element.section}, which is no "
                    f"{', '.join(PROPERTIES)} of the file."
                )
            card = self._properties[element.section]
            thickness = self._thickness(element) if card.name == "PSHELL" else None
            groups.setdefault((element.section, element.offset, thickness), []).append(element)
        found = [self._section(self._properties[key[0]], key[1], key[2], each) for key, each in groups.items()]
        self._notes.carried["sections"] += len(found)
        tables: dict[str, Any] = {"materials": self._used} if self._used else {}
        if len(found) == 1:
            return {**tables, "section": {key: value for key, value in found[0].items() if key != "elements"}}
        return {**tables, "section": found}

    def _thickness(self, element: Element) -> float | None:
        """Of an element whose corners give one; None where its property does."""
        texts = element.thicknesses
        if not texts:
            return None
        if len(set(texts)) > 1 or element.relative:
            raise ValueError(
                f"{element.card.where}: the thicknesses T1, T2, ... of element {element.label} must be equal."
            )
        return Card("T", texts[:1], element.card.where).number(1)

    def _section(self, card: Card, offset: float, thickness: float | None, elements: list[Element]) -> dict[str, Any]:
        triangles = np.sort(self._geometry.triangles([element.label for element in elements]))
        where = {"elements": self._geometry.named(triangles)}
        if card.name == "PSHELL":
            return {**where, **self._homogeneous(card, offset, thickness, elements)}
        return {**where, **self._composite(card, offset, elements)}

    def _homogeneous(self, card: Card, offset: float, thickness: float | None, elements: list[Element]):
        material = self._material(card, card.whole(2, 0))
        thickness = card.number(3) if thickness is None else thickness
        if not card.text(4):
            raise ValueError(f"{card.where}: PSHELL {card.text(1)} has no MID2, and so no bending.")
        if card.whole(4) != card.whole(2) or card.number(5, 1.0) != 1.0 or card.text(11):
            raise ValueError(
                f"{card.where}: PSHELL {card.text(1)} is read where MID2 is MID1, 12I/T3 is 1 and MID4 is left out."
            )
        if card.text(6):
            self._say_once(card, "transverse shear (MID3), which thin shells do not have")
        values = self._values(material, thickness, card.number(8, 0.0))
        if "young_modulus" in values and not offset:
            return {"thickness": thickness, **values}
        name = self._name(material, values, f"{material.text(1)} of PSHELL {card.text(1)}" if card.text(8) else None)
        return {
            "kind": "laminate",
            "direction": self._direction(elements, "young_modulus" in values),
            **({"offset": offset} if offset else {}),
            "plies": [{"material": name, "thickness": thickness}],
        }

    def _composite(self, card: Card, offset: float, elements: list[Element]) -> dict[str, Any]:
        kind = card.text(8).upper()
        if kind not in ("", "SYM"):
            raise ValueError(f"{card.where}: {card.name} {card.text(1)} is read with LAM blank or SYM, not {kind}.")
        if card.text(5) or card.text(7):
            self._say_once(card, "failure theory and damping (FT, GE)")
        rows = self._plies(card)
        symmetric = kind == "SYM"
        whole = sum(thickness for _, thickness, _ in rows) * (2 if symmetric else 1)
        nonstructural = card.number(3, 0.0) / whole
        plies = []
        for number, thickness, angle in rows:
            material = self._material(card, number)
            values = self._values(material, 1.0, nonstructural)
            label = f"{material.text(1)} of {card.name} {card.text(1)}" if nonstructural else None
            plies.append({"material": self._name(material, values, label), "thickness": thickness, "angle": angle})
        middle = offset + (card.number(2) + 0.5 * whole if card.text(2) else 0.0)
        if abs(middle) <= 1e-12 * whole:
            middle = 0.0
        isotropic = all(self._used[ply["material"]].get("young_modulus") for ply in plies)
        return {
            "kind": "laminate",
            "direction": self._direction(elements, isotropic),
            **({"offset": middle} if middle else {}),
            **({"symmetric": True} if symmetric else {}),
            "plies": plies,
        }

    def _plies(self, card: Card) -> list[tuple[int, float, float]]:
        """(material, thickness, angle) from the bottom up; an empty material or thickness is that of the ply before."""
        found: list[tuple[int, float, float]] = []
        if card.name == "PCOMP":
            starts = range(9, len(card.fields) + 1, 4)
            columns = (0, 1, 2)
        else:
            starts, columns = range(9, len(card.fields) + 1, 8), (1, 2, 3)
        for start in starts:
            number, thickness, angle = (start + column for column in columns)
            if not any(card.text(position) for position in (number, thickness, angle)):
                continue
            before = found[-1] if found else (None, None, 0.0)
            found.append((card.whole(number, before[0]), card.number(thickness, before[1]), card.number(angle, 0.0)))
        if not found:
            raise ValueError(f"{card.where}: {card.name} {card.text(1)} has no plies.")
        return found

    # --- directions --------------------------------------------------------------------------------------

    def _direction(self, elements: list[Element], isotropic: bool) -> Any:
        """THETA from the side G1-G2 about the normal, or the projected axis x of MCID; one for all where they agree."""
        if isotropic:
            return self._any_direction(elements)
        vectors = {element.label: self._vector(element) for element in elements}
        unique = {tuple(vector.tolist()) for vector in vectors.values()}
        if len(unique) == 1:
            return list(unique.pop())
        owner = [
            (triangle, vectors[element.label])
            for element in elements
            for triangle in self._geometry.triangles([element.label])
        ]
        return [vector.tolist() for _, vector in sorted(owner, key=lambda pair: pair[0])]

    def _any_direction(self, elements: list[Element]) -> Any:
        """A direction along all elements, where none counts: a global axis, or the first side of each."""
        x = np.asarray(self._geometry.mesh.nodes)[self._geometry.mesh.triangles]
        triangles = np.sort(self._geometry.triangles([element.label for element in elements]))
        sides, normals = x[triangles, 1] - x[triangles, 0], np.cross(*np.diff(x[triangles], axis=1).swapaxes(0, 1))
        along = np.abs(normals / np.linalg.norm(normals, axis=1, keepdims=True)).max(axis=0)
        return np.eye(3)[np.argmin(along)].tolist() if along.min() < 0.99 else sides.tolist()

    def _vector(self, element: Element) -> np.ndarray:
        text, card = element.theta, element.card
        if text.isdigit() and "." not in text:
            return self._geometry.systems.system(int(text), card).vector([1.0, 0.0, 0.0], card)
        x = self._geometry.corners(element)
        side = _unit(x[1] - x[0])
        angle = np.deg2rad(Card("THETA", [text], card.where).number(1, 0.0))
        if not angle:
            return side
        normal = np.cross(x[2] - x[0], x[3] - x[1]) if len(x) == 4 else np.cross(x[1] - x[0], x[2] - x[0])
        normal = _unit(normal)
        side = _unit(side - side @ normal * normal)
        return np.cos(angle) * side + np.sin(angle) * np.cross(normal, side)

    # --- materials ---------------------------------------------------------------------------------------

    def _material(self, card: Card, number: int) -> Card:
        if number not in self._materials:
            raise ValueError(f"{card.where}: {card.name} {card.text(1)} names material {number}, which there is not.")
        found = self._materials[number]
        if found.name not in MATERIALS:
            raise ValueError(f"{found.where}: {found.name} is not read; MAT1 and MAT8 are.")
        return found

    def _name(self, material: Card, values: dict[str, Any], label: str | None) -> str:
        name = f"material {label or material.text(1)}"
        self._used[name] = values
        return name

    def _values(self, card: Card, thickness: float, nonstructural: float) -> dict[str, Any]:
        """The keys of a material; mass that is not structural [mass/length²] is spread over the thickness."""
        if card.name == "MAT1":
            values, density, expansion, damping = self._isotropic(card)
        else:
            values = {
                "young_modulus_1": card.number(2),
                "young_modulus_2": card.number(3),
                "poisson_ratio_12": card.number(4),
                "shear_modulus_12": card.number(5),
            }
            density, damping = card.number(8, 0.0), card.text(17)
            expansion = {"expansion_1": card.number(9, 0.0), "expansion_2": card.number(10, 0.0)}
        if damping and card.number(8 if card.name == "MAT1" else 17):
            self._say_once(card, "structural damping GE")
        density = self._mass * (density + nonstructural / thickness)
        if not density:
            if not self._statics:
                raise ValueError(f"{card.where}: {card.name} {card.text(1)} has no density, which motion needs.")
            remark = f"{card} has no density: 1.0 stands in its place"
            if remark not in self._notes.remarks:
                self._notes.remarks.append(remark)
            density = 1.0
        return {**values, "density": density, **{key: value for key, value in expansion.items() if value}}

    def _isotropic(self, card: Card) -> tuple[dict[str, Any], float, dict[str, float], str]:
        E, G, nu = (card.text(position) for position in (2, 3, 4))
        if not E and not G:
            raise ValueError(f"{card.where}: MAT1 {card.text(1)} has neither E nor G.")
        ratio = card.number(4) if nu else card.number(2) / (2 * card.number(3)) - 1 if E and G else 0.0
        modulus = card.number(2) if E else 2 * card.number(3) * (1 + ratio)
        if E and G and nu and abs(card.number(3) * 2 * (1 + ratio) / modulus - 1) > _ISOTROPIC:
            raise ValueError(f"{card.where}: G of MAT1 {card.text(1)} is not E/2(1+NU): the material is not isotropic.")
        return (
            {"young_modulus": modulus, "poisson_ratio": ratio},
            card.number(5, 0.0),
            {"expansion": card.number(6, 0.0)},
            card.text(8),
        )

    def _say_once(self, card: Card, text: str) -> None:
        """What of a card is not carried over."""
        line = f"{card}: {text}"
        if line not in self._notes.left_out:
            self._notes.left_out.append(line)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
