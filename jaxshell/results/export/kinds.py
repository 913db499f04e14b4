"""The kinds of exports that `jaxshell export --to` knows: one more is one more entry."""

from typing import NamedTuple


class Kind(NamedTuple):
    """How a solution is written for another program."""

    suffix: str
    says: str
    method: str
    """Of `Solution`, which writes it to a path; what it needs is imported there."""
    has_fields: bool = False
    """Whether it takes fields, axes, failure and overwrite."""


KINDS = {
    "vtkhdf": Kind(".vtkhdf", "frames for ParaView", "to_vtkhdf", has_fields=True),
    "csv": Kind(".csv", "histories as a table", "to_csv"),
}
