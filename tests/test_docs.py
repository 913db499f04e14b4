"""The manual: its code runs as it stands, its reference has every public name, its gallery every example.

A block of Python, TOML or shell that is not to be run by itself has the title "fragment". Links between pages are the
site's to check (`mkdocs build --strict`, in `.ci/run`).
"""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

import jaxshell as js
from jaxshell.command.cli import main

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
BLOCK = re.compile(r'^```(python|toml|sh)(?: title="([^"]*)")?\n(.*?)^```$', flags=re.MULTILINE | re.DOTALL)


def blocks(page: Path) -> list[tuple[str, str, str]]:
    """(language, title, text) of the blocks that claim to run."""
    found = [block.groups(default="") for block in BLOCK.finditer(page.read_text(encoding="utf-8"))]
    return [block for block in found if block[1] != "fragment"]


PAGES = [page for page in sorted(DOCS.glob("*.md")) if page.name != "extending.md" and blocks(page)]
"""test_extending runs its page, and looks at the answers."""


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_page_runs(page, tmp_path, monkeypatch):
    """One block after the other in an empty folder, in one namespace, as a reader would paste them."""
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for language, title, text in blocks(page):
        if language == "python":
            exec(compile(text, page.name, "exec"), names)
        elif language == "toml":
            tomllib.loads(text)
            assert title, f"{page.name}: a scene file needs its name as a title, or the title 'fragment'"
            Path(title).write_text(text, encoding="utf-8")
        else:
            for line in text.splitlines():
                if line.startswith("jaxshell "):
                    assert main(shlex.split(line, comments=True)[1:]) == 0, line


def test_every_block_says_what_it_is():
    """A block that no regular expression here finds would not be run."""
    for page in DOCS.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        opened = re.findall(r"^ *```+(?:python|py|toml|sh|bash|console)\b.*$", text, flags=re.MULTILINE)
        assert len(opened) == len(BLOCK.findall(text)), page.name


def test_the_reference_has_every_public_name():
    text = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "reference").glob("*.md"))
    listed = re.findall(r"^::: jaxshell\.(\w+)$", text, flags=re.MULTILINE)
    rooms = {"gradients", "methods"}  # what they hold is listed name by name
    assert sorted(listed) == sorted(set(js.__all__) - rooms)
    for room in rooms:
        assert f"`js.{room}`" in text


def test_the_gallery_has_every_example_with_a_small_picture():
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    for example in (*ROOT.glob("examples/*.py"), *ROOT.glob("examples/*.toml"), *ROOT.glob("notebooks/*.ipynb")):
        assert f"](../{example.relative_to(ROOT).as_posix()})" in text, example.name
        picture = f"pictures/gallery/{example.stem}.png"
        assert f"]({picture})" in text, example.name
        assert 0 < (DOCS / picture).stat().st_size < 100_000, picture
