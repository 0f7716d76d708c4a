"""Output of a look at a recording: a table, a picture, a page, a JSON file."""

from tg4mm.show.look.page import write_page, write_picture
from tg4mm.show.look.words import Words, write_json_file

__all__ = ["Words", "write_json_file", "write_page", "write_picture"]
