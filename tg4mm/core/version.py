"""The version of tg4mm, here so that every module can import it without a circle."""

__version__ = "0.1.0"
