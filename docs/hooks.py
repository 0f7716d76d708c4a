"""Pages of the site that are made from the code: commands, settings, and the texts of the repository's root."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import io
import os
import tokenize
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
# Texts that a repository's root must hold, and their pages.
ROOT_PAGES = {"SECURITY.md": "security.md", "CHANGELOG.md": "changelog.md"}


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
    from tg4mm.cli.bench import COMMANDS as BENCH
    from tg4mm.cli.program import COMMANDS, help_text

    os.environ["COLUMNS"] = "100"
    parts = ["# Commands\n", "What `--help` prints; made from the program itself.\n", _block(help_text())]
    for name in [*COMMANDS, "bench"]:
        text = parser().format_help() if name == "generate" else help_text(name)
        parts += [f"## {name}\n", _block(text)]
    parts += [part for one in BENCH for part in (f"### bench {one}\n", _block(help_text("bench", one)))]
    return "\n".join(parts)


def settings_page() -> str:
    """A table of settings for every preset."""
    from tg4mm.run.preset import presets

    parts = [
        "# Settings\n",
        "Settings of `tg4mm train`, given as `--set stage.name=value`; made from the program itself "
        "(`tg4mm train --list-settings` prints the same).\n",
    ]
    for preset, chosen in presets().items():
        parts.append(f"## Preset {preset}\n\n| setting | default | unit | meaning |\n|---|---|---|---|")
        for stage, config in chosen.defaults.items():
            for field in dataclasses.fields(config):
                value = str(getattr(config, field.name))
                value = value.lower() if value in ("True", "False", "None") else value
                unit, about = field.metadata.get("unit", ""), field.metadata.get("about", "")
                parts.append(f"| `{stage}.{field.name}` | {value} | {unit} | {about.replace('|', '/')} |")
        parts.append("")
    return "\n".join(parts)


def api_page() -> str:
    """The public names of the package: docstrings, and the fields of dataclasses with their meaning."""
    import tg4mm

    parts = ["# Python API\n", "The public names of `tg4mm`; [how they fit together](python.md).\n"]
    for name in tg4mm.__all__:
        value = getattr(tg4mm, name)
        path = f"{value.__module__}.{value.__qualname__}"
        if not dataclasses.is_dataclass(value):
            parts.append(f"::: {path}\n")
            continue
        rows = [f"| `{field}` | `{kind}` | {about} |" for field, kind, about in fields_of(value)]
        parts.append(f"::: {path}\n    options: {{ members: [] }}\n")
        parts.append("\n".join(["| field | type | meaning |", "|---|---|---|", *rows, ""]))
        parts += [f"::: {path}.{one}\n    options: {{ heading_level: 3 }}\n" for one in members_of(value)]
    return "\n".join(parts)


def members_of(cls: type) -> list[str]:
    """Public methods and properties that a class itself defines."""
    fields = {field.name for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    return [name for name in vars(cls) if not name.startswith("_") and name not in fields]


def fields_of(cls: type) -> list[tuple[str, str, str]]:
    """Name, type and meaning of a dataclass's fields.

    The meaning comes from the comment beside or above each field, or from its `setting`.
    """
    source = inspect.getsource(cls)
    (body,) = ast.parse(source).body
    assert isinstance(body, ast.ClassDef)
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT and "type: ignore" not in token.string
    }
    alone = {n for n in comments if source.splitlines()[n - 1].lstrip().startswith("#")}
    about = {f.name: f.metadata.get("about", "") for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    found = []
    for node in body.body:
        if not isinstance(node, ast.AnnAssign) or not isinstance(node.target, ast.Name):
            continue
        lines = [n for n in range(node.lineno, (node.end_lineno or node.lineno) + 1) if n in comments]
        first = node.lineno
        while not lines and first - 1 in alone:
            first -= 1
        words = " ".join(comments[n] for n in lines or range(first, node.lineno)) or about[node.target.id]
        kind = " ".join(ast.unparse(node.annotation).split())
        found.append((node.target.id, kind.replace(" | ", " or "), words.replace("|", "\\|")))
    return found


def _block(text: str) -> str:
    return f"```text\n{text.rstrip()}\n```\n"
