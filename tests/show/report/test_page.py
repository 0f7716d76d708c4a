"""The page assembly: escaping, embedding, structure."""

import base64
import io

import numpy as np
from PIL import Image

from tests.show.report.page_checks import outside_loads, read_page
from tg4mm.core.pages.page import (
    Commands,
    Figure,
    Page,
    Section,
    Stat,
    Table,
    Text,
    data_uri,
    drawing,
    missing,
    picture,
    render_page,
)
from tg4mm.core.pages.svg import colour_bar

EVIL = "<script>alert('x')</script>\"><img src=x onerror=alert(1)>"


def page(text: str) -> str:
    figure = Figure([picture(np.zeros((2, 2, 3)), text), missing(text, text)], text, controls=True)
    chart = Figure([drawing(colour_bar(1.0, text, text))], text, width="narrow")
    table = Table([text, text], [[text, text]], text, ["ours"])
    blocks = [Text(text), Text(text, "note"), figure, chart, table, Commands([(text, text)])]
    return render_page(
        Page(text, text, text, [Stat(text, text, text, text)], [figure], [Section(text, blocks)], text)
    )


def test_every_string_is_escaped_wherever_it_stands():
    harmless, evil = read_page(page("harmless")), read_page(page(EVIL))
    assert evil.tags == harmless.tags
    assert not evil.handlers
    assert "".join(evil.text).count(EVIL) == "".join(harmless.text).count("harmless") > 10


def test_the_page_is_well_formed_and_loads_nothing():
    text = page("x")
    reader = read_page(text)
    assert not reader.errors
    assert not reader.open
    assert not outside_loads(text)
    assert "default-src 'none'" in text


def test_pictures_are_embedded_whole():
    image = np.random.default_rng(0).integers(0, 256, (5, 4, 3), dtype=np.uint8)
    source = picture(image).source
    assert source.startswith("data:image/png;base64,")
    with Image.open(io.BytesIO(base64.b64decode(source.split(",")[1]))) as back:
        np.testing.assert_array_equal(np.asarray(back), image)
    assert data_uri("video/mp4", b"\x00\x01") == "data:video/mp4;base64,AAE="
