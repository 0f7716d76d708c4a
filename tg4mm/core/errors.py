"""The one exception family: what a user can mend. The command line prints it as one line and exits with 2."""


class Tg4mmError(ValueError):
    """Bad input. The message is one line, names the file or option, and shows the offending value."""


class CaptureError(Tg4mmError):
    """A capture (images, cameras, times) that cannot be read or contradicts itself."""


class MissingSplitError(CaptureError):
    """A capture that has no such split: no test images, say."""


class SplatFileError(Tg4mmError):
    """A splat file that is truncated, foreign, of an unknown version, or holds non-finite numbers."""


class RunError(Tg4mmError):
    """A run folder or checkpoint that is missing, truncated, foreign, or does not fit the request."""


class RegionError(Tg4mmError):
    """A file of regions, a region or a scale that cannot be."""
