"""The checks of pages can fail."""

import pytest

from tests.show.report.page_checks import outside_loads, read_page


@pytest.mark.parametrize(
    "bad",
    [
        '<img src="http://x/y.png">',
        '<img src="y.png">',
        '<link href="https://fonts.example/css">',
        "<style>@import 'a.css';</style>",
        "<style>p { background: url(https://x/y.png) }</style>",
        "<script>fetch('/a')</script>",
    ],
)
def test_loading_from_elsewhere_is_seen(bad):
    assert outside_loads(bad)
    assert not outside_loads('<img src="data:image/png;base64,AA=="><rect fill="url(#g)"></rect>')


def test_bad_nesting_is_seen():
    assert read_page("<p><b>x</p></b>").errors
    assert read_page("<p><b>x</b>").open == ["p"]
    assert not read_page("<p><b>x</b></p>").errors
