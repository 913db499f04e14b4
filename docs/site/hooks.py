"""What the manual takes from outside docs/: notebooks, examples, CHANGELOG and CONTRIBUTING, the commands' options.

Pages link to them as they lie in the repository (`../examples/x.py`); in the site they lie beside the pages.
"""

import argparse
import ast
import os
import re
from pathlib import Path
from urllib.parse import unquote

from mkdocs.plugins import event_priority, get_plugin_logger
from mkdocs.structure.files import File

from jaxshell.command import cli

ROOT = Path(__file__).parents[2]
PICTURES = "pictures/gallery"
LOG = get_plugin_logger("links")


@event_priority(100)  # before mkdocs-jupyter looks for notebooks
def on_files(files, config):
    for path in sorted(ROOT.glob("notebooks/*.ipynb")):
        files.append(File(f"notebooks/{path.name}", str(ROOT), config.site_dir, config.use_directory_urls))
    for name in ("CHANGELOG.md", "CONTRIBUTING.md"):
        files.append(File(name, str(ROOT), config.site_dir, config.use_directory_urls))
    for path in examples():
        files.append(File.generated(config, f"examples/{path.name}.md", content=example_page(path)))
    files.append(File.generated(config, "commands.md", content=commands_page()))
    return files


def on_page_markdown(markdown, page, config, files):
    """Links to the repository's files as links to their pages."""
    markdown = re.sub(r"\]\(\.\./(examples/[\w.]+)\)", r"](\1.md)", markdown)
    markdown = re.sub(r"\]\(\.\./((?:notebooks/|CHANGELOG|CONTRIBUTING)[\w.]*)", r"](\1", markdown)
    return re.sub(r"\]\(docs/", "](", markdown) if page.file.src_uri == "CONTRIBUTING.md" else markdown


def on_post_page(output, page, config):
    """Notebooks are pages already: their links to the repository's pages, as the site has them."""
    if not page.file.src_uri.endswith(".ipynb"):
        return output
    return re.sub(r'href="\.\./docs/([\w/]+)\.md', r'href="../../\1/', output)


def on_post_build(config):
    """A warning, which `--strict` counts, for every link within the built site that leads nowhere."""
    site = Path(config.site_dir)
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for link in set(re.findall(r'(?:href|src)="([^"#?]+)', text)):
            if not re.match(r"[a-z]+:|/|\$", link) and not (page.parent / unquote(link)).exists():
                LOG.warning("%s links to %s, which is not in the site.", page.relative_to(site), link)


def examples():
    """Programs and files of examples/, in the order of their names."""
    return sorted(path for path in ROOT.glob("examples/*") if path.suffix in (".py", ".toml", ".inp", ".bdf", ".geo"))


def example_page(path: Path) -> str:
    """A page of an example: what it says of itself, its picture, its text."""
    text, picture = path.read_text(encoding="utf-8"), f"{PICTURES}/{path.stem}.png"
    fence, body = {"python": path.suffix == ".py", "toml": path.suffix == ".toml"}, text
    language = next((name for name, is_it in fence.items() if is_it), "text")
    parts = [f"# {path.name}"]
    if path.suffix == ".py":
        said = ast.get_docstring(ast.parse(text)) or ""
        body = text.split('"""', 2)[2].lstrip("\n")
        parts.append(said)
    if (ROOT / "docs" / picture).exists():
        parts.append(f"![{path.stem}](../{picture})")
    parts.append(f"````{language}\n{body}````")
    return "\n\n".join(parts) + "\n"


def commands_page() -> str:
    """Every command with its options, as `--help` prints them."""
    os.environ["COLUMNS"] = "100"
    parser = argparse.ArgumentParser(prog="jaxshell")
    commands = parser.add_subparsers()
    for command in cli.COMMANDS:
        command.add(commands)
    shown = [
        "# Commands\n\nWhat `jaxshell COMMAND --help` prints. Exit status: 0, or 1 when a run failed (what it finished "
        "is kept and drawn), 2 for bad input, 128 and the signal's number when a signal stopped it.\n"
    ]
    for name, of_command in commands.choices.items():
        shown.append(f"## {name}\n\n```text\n{of_command.format_help()}```\n")
    return "\n".join(shown)
