"""Materials, sections and initial strains of a scene file.

    [materials.NAME]    young_modulus, poisson_ratio, density, expansion; or young_modulus_1, young_modulus_2,
                        poisson_ratio_12, shear_modulus_12, density, expansion_1, expansion_2
    [section]           kind = "isotropic" (where it is left out), its keys those of `jaxshell.Section`;
                        kind = "laminate": plies = [{ material, thickness, angle }, ...], or layup = "[45/-45/0/90]s"
                        with material and ply_thickness; direction, offset, symmetric;
                        kind = "general": A, B, D, mass_per_area, ... as in `jaxshell.GeneralSection`
    [[section]]         several: each the same with elements, the name of a set, a list of numbers, or
                        { plane = ..., box = ... } for the elements' centroids; "others" are those that none names
    [[thermal]]         temperature, gradient, history
    [[initial_strain]]  strain, curvature, direction, history

A direction is [x, y, z], one of them per triangle, or { axis, origin, along } of a cylinder.
"""

from typing import Any

import numpy as np

from jaxshell.files.selectors import chosen_elements
from jaxshell.files.tables import Table
from jaxshell.model.materials import MATERIALS, Isotropic, Material, Orthotropic
from jaxshell.model.mesh import Mesh
from jaxshell.model.sections import SECTIONS, AnySection, Cylindrical, Laminate, Ply, Regions, Section
from jaxshell.numerics.checks import shown
from jaxshell.numerics.nearest import meant

MATERIAL_KINDS = {material.kind: material for material in MATERIALS}
SECTION_KINDS = {section.kind: section for section in SECTIONS if section is not Regions}
_OTHERS = "others"


def read_materials(table: Table) -> dict[str, Material]:
    """The materials of the file by name."""
    found = {}
    for name in table.content:
        inner = Table(f"[materials.{name}]", table.content[name])
        default = Orthotropic.kind if "young_modulus_1" in inner.content else Isotropic.kind
        found[name] = inner.fields(MATERIAL_KINDS[chosen_kind(inner, MATERIAL_KINDS, default)], "kind")
    return found


def read_section(top: Table, materials: dict[str, Material], mesh: Mesh) -> AnySection:
    """The shell's section, or the sections of its regions."""
    if not isinstance(top.get("section"), list):
        return _section(top.table("section"), materials)
    names, elements, sections = [], [], []
    for position, table in enumerate(top.tables("section")):
        where = table.get("elements")
        names.append(where if isinstance(where, str) else str(position + 1))
        taken = np.concatenate([np.zeros(0, int), *elements])
        elements.append(_elements(table, mesh, taken))
        rest = {key: value for key, value in table.content.items() if key != "elements"}
        sections.append(_section(Table(table.name, rest), materials))
    return Table("[[section]]", {}).call(Regions, elements, sections, names)


def read_direction(table: Table, key: str) -> Any:
    """A vector, one for each element, or the directions of a cylinder."""
    value = table.get(key)
    if not isinstance(value, dict):
        return value
    return table.table(key).fields(Cylindrical)


def chosen_kind(table: Table, kinds: dict[str, Any], default: str | None = None) -> str:
    """The table's `kind`, one of the names of `kinds`."""
    name = table.text("kind", default)
    if name not in kinds:
        choices = ", ".join(map(repr, kinds))
        raise ValueError(f"{table.name} kind must be one of {choices}, but it is {name!r}.{meant(name, kinds)}")
    return name


def _section(table: Table, materials: dict[str, Material]) -> AnySection:
    kind = SECTION_KINDS[chosen_kind(table, SECTION_KINDS, Section.kind)]

    def material(table: Table, key: str) -> Material:
        name = table.text(key)
        if name not in materials:
            known = f"those of the file are {', '.join(map(repr, materials))}" if materials else "the file has none"
            raise ValueError(f"{table.name} There is no material {shown(name)}: {known}.{meant(name, materials)}")
        return materials[name]

    def plies(table: Table, key: str) -> list[Ply]:
        return [ply.fields(Ply, material=material) for ply in table.tables(key)]

    if kind is not Laminate:
        return table.fields(kind, "kind", direction=read_direction)
    if ("layup" in table.content) == ("plies" in table.content):
        raise ValueError(f"{table.name} needs either plies, or layup with material and ply_thickness.")
    if "layup" in table.content:
        return table.fields(Laminate.from_layup, "kind", material=material, direction=read_direction)
    return table.fields(Laminate, "kind", plies=plies, direction=read_direction)


def _elements(table: Table, mesh: Mesh, taken: np.ndarray) -> np.ndarray:
    where = table.get("elements")
    if not isinstance(where, str):
        return chosen_elements(table, "elements", mesh)
    if where == _OTHERS and _OTHERS not in mesh.element_sets:
        others = np.setdiff1d(np.arange(mesh.n_elements), taken)
        if not others.size:
            raise ValueError(f"{table.name} There are no other elements: the sections above name all of them.")
        return others
    return table.call(mesh.element_set, where)
