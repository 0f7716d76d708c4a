"""Reading a page as a browser would: is it well-formed, what does it load, what does it say."""

import re
from html.parser import HTMLParser
from xml.etree import ElementTree

VOID = {"meta", "img", "br", "link", "input", "hr", "source"}
LOADING = {"src", "href", "poster", "srcset", "data", "action", "background"}


class PageReader(HTMLParser):
    """Collects errors of nesting, what attributes load, tags and text."""

    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.errors: list[str] = []
        self.loads: list[str] = []
        self.tags: list[str] = []
        self.text: list[str] = []
        self.handlers: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.loads += [value or "" for name, value in attrs if name in LOADING]
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open[-1] != tag:
            self.errors.append(f"</{tag}> at {self.getpos()} closes {self.open[-1:]}")
        else:
            self.open.pop()

    def handle_data(self, data):
        if self.open and self.open[-1] not in {"script", "style"}:
            self.text.append(data)


def read_page(text):
    """The page as read; `errors` and `open` are empty for a well-formed one."""
    reader = PageReader()
    reader.feed(text)
    reader.close()
    return reader


def outside_loads(text):
    """Everything the page would fetch from elsewhere, in attributes, styles and scripts."""
    page = read_page(text)
    found = [value for value in page.loads if not value.startswith(("data:", "#"))]
    found += re.findall(r"url\((?!#|\"#|data:)[^)]*\)", text)
    found += re.findall(r"@import[^;]*;", text)
    found += re.findall(r"\b(?:fetch|XMLHttpRequest|WebSocket|importScripts)\b\s*\(", text)
    return found


def words(text):
    """What a page says."""
    return " ".join(" ".join(read_page(text).text).split())


def check(text):
    """A page is well-formed, its drawings are XML, and it loads nothing."""
    reader = read_page(text)
    assert not reader.errors
    assert not reader.open
    assert not outside_loads(text)
    for svg in re.findall(r"<svg.*?</svg>", text, re.S):
        ElementTree.fromstring(svg)
