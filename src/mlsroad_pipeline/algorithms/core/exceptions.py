"""Exceptions of mlsroad; `MlsRoadError` is the base class."""


class MlsRoadError(Exception):
    """Base class of the exceptions of mlsroad."""


class DataError(MlsRoadError, ValueError):
    """Invalid data; the message gives the file and the value."""


class MissingColumnError(DataError):
    """A point cloud lacks a required column."""


class UnknownClassError(DataError):
    """A label code is missing from the class scheme or coding."""


class ReadError(DataError):
    """A file cannot be read: truncated, empty, or of another format than its extension."""


class ParameterError(MlsRoadError, ValueError):
    """A parameter is outside its domain; the message gives its name and value."""
