"""Check the links of the documentation, without a network: `python docs/links.py` names each that leads nowhere."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from markdown.extensions.toc import slugify

ROOT = Path(__file__).resolve().parent.parent
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md"))]
# Made by docs/hooks.py when the site is built; their anchors are checked there.
GENERATED = {"commands.md", "settings.md", "api.md", "security.md", "changelog.md"}

_CODE = re.compile(r"^```.*?^```|^(?: {4}|\t).*?$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\((?!\w+:)([^)\s]+)\)")


def anchors(page: Path) -> set[str]:
    """The anchors of a page: its headings' and its own."""
    text = page.read_text(encoding="utf-8")
    headings = re.findall(r"^#+ +(.+?) *$", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S), re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading) for heading in headings]
    return {slugify(heading, "-") for heading in plain} | set(re.findall(r'<a id="([^"]+)"', text))


def broken(page: Path) -> list[str]:
    """The links of a page to a file or an anchor that does not exist."""
    found = []
    for link in _LINK.findall(_CODE.sub("", page.read_text(encoding="utf-8"))):
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        if target.name in GENERATED and not target.exists():
            continue
        if not target.exists() or (anchor and anchor not in anchors(target)):
            found.append(link)
    return found


def main() -> int:
    """Print every broken link; return how many there are."""
    lines = [f"{page.relative_to(ROOT)}: {link} leads nowhere" for page in PAGES for link in broken(page)]
    print("\n".join(lines) or f"links of {len(PAGES)} pages: all lead somewhere")
    return len(lines)


if __name__ == "__main__":
    sys.exit(1 if main() else 0)
