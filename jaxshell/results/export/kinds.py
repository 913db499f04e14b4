"""The kinds of exports that `jaxshell export --to` knows: one more is one more entry."""

from collections.abc import Callable
from typing import NamedTuple

from jaxshell.results.export.table import save_csv
from jaxshell.results.export.vtkhdf import save_vtkhdf


class Kind(NamedTuple):
    """How a solution is written for another program: `save(solution, path)`."""

    suffix: str
    says: str
    save: Callable
    has_fields: bool
    """Whether `save` takes fields, axes, failure and overwrite."""


KINDS = {
    "vtkhdf": Kind(".vtkhdf", "frames for ParaView", save_vtkhdf, True),
    "csv": Kind(".csv", "histories as a table", save_csv, False),
}
