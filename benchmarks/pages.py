"""Tables in the pages of docs/: how they are written, and their places between `<!-- name -->` and `<!-- end name -->`."""

import argparse
import re
from collections.abc import Callable
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


def mesh_name(divisions: int | list | tuple) -> str:
    """20, or 24×5."""
    return "×".join(map(str, divisions if isinstance(divisions, list | tuple) else [divisions]))


def table(header: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = ["| " + " | ".join(cells) + " |" for cells in (header, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(header), *lines[1:]])


def write(description: str | None, page: Path, tables: dict[str, Callable[[], str]]) -> None:
    """The command of a script that makes a page's tables: all of them, or those that its arguments name."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[[], *tables], help="which tables; all by default")
    for name in parser.parse_args().tables or tables:
        text = tables[name]()
        print(f"{name}\n{text}\n", flush=True)
        fill(page, {name: text})
