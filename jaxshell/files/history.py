"""Histories of a scene file: `{ times, values }` or `{ ramp = t }`."""

from jaxshell.files.tables import Table
from jaxshell.model.history import History


def read_history(table: Table) -> History | None:
    """The history of a table; None where it has none."""
    if "history" not in table.content:
        return None
    inner = table.table("history")
    inner.only("ramp", "times", "values")
    if "ramp" in inner.content:
        inner.only("ramp")
        return table.call(History.ramp, inner.get("ramp"))
    return table.call(History, inner.get("times"), inner.get("values"))
