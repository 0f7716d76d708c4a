"""Gives README.md whole addresses, and pyproject.toml the project's: python .github/whole_links.py REPOSITORY TAG.

REPOSITORY is the address of the repository on GitHub. Pictures are taken from `raw/TAG/…`, other files from
`blob/TAG/…`. The sources name no address of their own, so that a copy elsewhere links to itself.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!\w+:|#)([^)\s]+)\)")


def whole_links(text: str, repository: str, tag: str) -> str:
    """Markdown whose relative links lead to the files of a tag."""

    def whole(match: re.Match[str]) -> str:
        kind = "raw" if match[1] else "blob"
        return f"{match[1]}[{match[2]}]({repository}/{kind}/{tag}/{match[3]})"

    return _LINK.sub(whole, text)


def project_urls(repository: str, tag: str) -> str:
    """The table of pyproject.toml that the package index shows beside the page."""
    return (
        f'\n[project.urls]\nRepository = "{repository}"\nDocumentation = "{repository}/blob/{tag}/docs/index.md"\n'
        f'Changelog = "{repository}/blob/{tag}/CHANGELOG.md"\nIssues = "{repository}/issues"\n'
    )


def main(repository: str, tag: str, root: str = ".") -> None:
    """Rewrites README.md and pyproject.toml in `root`."""
    readme, project = Path(root) / "README.md", Path(root) / "pyproject.toml"
    readme.write_text(whole_links(readme.read_text(encoding="utf-8"), repository, tag), encoding="utf-8")
    project.write_text(project.read_text(encoding="utf-8") + project_urls(repository, tag), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
