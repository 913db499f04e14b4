"""Tables in the pages of docs/: how they are written, and their places between `<!-- name -->` and `<!-- end name -->`."""

import re
from pathlib import Path


def fill(page: Path, tables: dict[str, str]) -> None:
    """Write each table to its place. Raises ValueError where the page has none."""
    text = page.read_text(encoding="utf-8")
    for name, table in tables.items():
        block = re.compile(f"(<!-- {name} -->\n).*?(<!-- end {name} -->)", re.DOTALL)
        if not block.search(text):
            raise ValueError(f"{page.name} has no place for the table {name!r}.")
        text = block.sub(lambda found, table=table: f"{found[1]}{table}\n{found[2]}", text)
    page.write_text(text, encoding="utf-8")


def table(header: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = ["| " + " | ".join(cells) + " |" for cells in (header, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(header), *lines[1:]])
