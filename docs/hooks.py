"""Pages of the site that are made from the code: commands, settings, and the texts of the repository's root."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType
from typing import Any

from mkdocs.structure.files import File, Files
from typer.testing import CliRunner

ROOT = Path(__file__).resolve().parent.parent
# Texts that a repository's root must hold, and their pages.
ROOT_PAGES = {"SECURITY.md": "security.md", "CHANGELOG.md": "changelog.md"}
_WIDTH = {"COLUMNS": "100", "TERMINAL_WIDTH": "100", "NO_COLOR": "1"}


def on_files(files: Files, config: Any) -> Files:
    """Adds the generated pages (mkdocs calls this before anything is rendered)."""
    pages = {"commands.md": commands_page(), "settings.md": settings_page()}
    pages["api.md"] = api_page()
    pages |= {page: (ROOT / name).read_text(encoding="utf-8") for name, page in ROOT_PAGES.items()}
    pages |= {
        f"examples/{path.name}": path.read_text(encoding="utf-8") for path in ROOT.glob("examples/*.ipynb")
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Links between docs/ and what lies beside it, as the site has them."""
    markdown = markdown.replace("](../examples/", "](examples/")
    for name, target in ROOT_PAGES.items():
        markdown = markdown.replace(f"](../{name}", f"]({target}")
        if page.file.src_uri == target:
            markdown = markdown.replace("](docs/", "](").replace(f"]({name}", f"]({target}")
    return markdown


def commands_page() -> str:
    """`--help` of every command, as the terminal shows it."""
    from dataset_gen.options import parser
    from tg4mm.cli.program import app

    def said(*words: str) -> str:
        result = CliRunner().invoke(app, [*words, "--help"], env=_WIDTH, prog_name="tg4mm")
        return result.output.strip()

    names = re.findall(r"^  ([a-z][a-z-]*)  ", said().split("Commands:")[1], re.MULTILINE)
    parts = ["# Commands\n", "What `--help` prints; made from the program itself.\n", _block(said())]
    for name in names:
        text = parser().format_help() if name == "generate" else said(name)
        parts += [f"## {name}\n", _block(text)]
        if "\nCommands:" in text:
            inner = re.findall(r"^  ([a-z][a-z-]*)(?:  |$)", text.split("\nCommands:")[1], re.MULTILINE)
            for one in inner:
                parts += [f"### {name} {one}\n", _block(said(name, one))]
    return "\n".join(parts)


def settings_page() -> str:
    """A table of settings for every preset."""
    import dataclasses

    from tg4mm.train import PRESETS

    parts = [
        "# Settings\n",
        "Settings of `tg4mm train`, given as `--set stage.name=value`; made from the program itself "
        "(`tg4mm train --list-settings` prints the same).\n",
    ]
    for preset, defaults in PRESETS.items():
        parts.append(f"## Preset {preset}\n\n| setting | default | unit | meaning |\n|---|---|---|---|")
        for stage, config in defaults.items():
            for field in dataclasses.fields(config):
                value = str(getattr(config, field.name))
                value = value.lower() if value in ("True", "False", "None") else value
                unit, about = field.metadata.get("unit", ""), field.metadata.get("about", "")
                parts.append(f"| `{stage}.{field.name}` | {value} | {unit} | {about.replace('|', '/')} |")
        parts.append("")
    return "\n".join(parts)


def api_page() -> str:
    """The public names of the package, with their docstrings."""
    import tg4mm

    parts = ["# Python API\n", "The public names of `tg4mm`; [how they fit together](python.md).\n"]
    for name in tg4mm.__all__:
        value = getattr(tg4mm, name)
        value = getattr(value, name, value) if isinstance(value, ModuleType) else value
        parts.append(f"::: {value.__module__}.{value.__qualname__}\n")
    return "\n".join(parts)


def _block(text: str) -> str:
    return f"```text\n{text.rstrip()}\n```\n"
