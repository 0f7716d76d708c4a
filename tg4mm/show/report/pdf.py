"""A page as PDF, printed by a browser of this machine, or by the one that playwright brings."""

import os
import shutil
import subprocess
import tempfile
from functools import partial
from pathlib import Path

from tg4mm.core.errors import RunError
from tg4mm.core.extras import install
from tg4mm.core.files import write_atomic

_NAMES = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "msedge",
)
_PROGRAMS = "Google/Chrome/Application/chrome.exe", "Microsoft/Edge/Application/msedge.exe"
_APPLICATIONS = "Google Chrome", "Chromium", "Microsoft Edge"
_LONGEST = 300  # seconds


def printer() -> str:
    """The program that prints: Chromium, Chrome or Edge. Raises RunError where there is none."""
    found = [path for name in _NAMES if (path := shutil.which(name))]
    places = [Path(f"/Applications/{name}.app/Contents/MacOS/{name}") for name in _APPLICATIONS]
    places += [
        Path(os.environ[folder]) / name
        for folder in ("PROGRAMFILES", "PROGRAMFILES(X86)") if folder in os.environ for name in _PROGRAMS
    ]  # fmt: skip
    found += [str(place) for place in places if place.is_file()]
    path = found[0] if found else _of_playwright()
    if path is None:
        raise RunError(
            "--pdf: no Chromium, Chrome or Edge is on this machine; install one, or "
            f"{install('pdf')} && playwright install chromium"
        )
    return path


def _of_playwright() -> str | None:
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return None
    with sync_playwright() as play:
        path = play.chromium.executable_path
    return path if Path(path).is_file() else None


def print_pdf(page: Path, browser: str) -> Path:
    """PAGE.pdf beside a page, by `printer`'s program; videos become stills. Raises RunError where it prints nothing."""
    out = page.with_suffix(".pdf")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        printed = Path(folder) / "page.pdf"
        sandbox = (
            ["--no-sandbox"] if getattr(os, "geteuid", lambda: 1)() == 0 else []
        )  # Chromium refuses root one
        command = [
            browser, "--headless", "--disable-gpu", *sandbox, f"--user-data-dir={folder}/profile",
            "--no-pdf-header-footer", f"--print-to-pdf={printed}", page.resolve().as_uri(),
        ]  # fmt: skip
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise RunError(f"{out}: {browser} did not print: {error}") from None
        if done.returncode or not printed.is_file():
            said = done.stderr.strip().splitlines()[-1:] or ["nothing said"]
            raise RunError(f"{out}: {browser} did not print (exit code {done.returncode}): {said[0]}")
        write_atomic(out, partial(shutil.copyfile, printed))
    return out
