"""Every error that mlsroad raises on purpose descends from `MlsRoadError`."""


class MlsRoadError(Exception):
    """Root of the project's own errors."""


class DataError(MlsRoadError, ValueError):
    """The data cannot be used as they are; the message names the file and the value."""


class MissingColumnError(DataError):
    """A point cloud lacks a column that the work needs."""


class UnknownClassError(DataError):
    """A label code that the class scheme does not name."""


class ReadError(DataError):
    """A file cannot be read: truncated, of another format than its name says, or empty."""


class ParameterError(MlsRoadError, ValueError):
    """A parameter is outside its domain; the message names it and its value."""
