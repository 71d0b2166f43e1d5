"""Text of files and of other people on a terminal and in a log."""

import re

_BREAK = re.compile(r" *[\t\n\r\v\f\x1c-\x1e\x85\u2028\u2029]\s*")
_PASSWORD = re.compile(r"(?<=://)([^\s/@:]*):[^\s@]*@")
_SECRET = re.compile(r"(?i)((?:password|passwd|token|secret|api_?key)\s*[=:]\s*)[^\s&;,)\"']+")


def printable(text: object) -> str:
    """Return a text as one line without control characters.

    Parameters
    ----------
    text : object
        A text, or an object with one, such as an error.

    Returns
    -------
    str
        The text with a blank in place of each line break and tab, and of the blanks around it. Control characters,
        which move the cursor or colour a terminal, and undecodable bytes of file names are escaped.

    Examples
    --------
    >>> printable("a\\x1b[31m\\nb  c.laz")
    'a\\\\x1b[31m b  c.laz'
    """
    line = _BREAK.sub(" ", str(text)).strip()
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def shortened(text: object, most: int = 80) -> str:
    """Return a text of at most `most` characters; a longer one ends with three dots.

    Examples
    --------
    >>> shortened("road, sidewalk, wall", 17)
    'road, sidewalk...'
    """
    line = str(text)
    return line if len(line) <= most else f"{line[: most - 3]}..."


def without_password(text: str) -> str:
    """Return a text in which passwords of addresses, and values named as secrets, are replaced by stars.

    Examples
    --------
    >>> without_password("postgresql://ann:pa:ss@db/mlflow?password=x is down")
    'postgresql://ann:***@db/mlflow?password=*** is down'
    """
    return _SECRET.sub(r"\1***", _PASSWORD.sub(r"\1:***@", text))


def torch_error(error: Exception) -> str:
    """Return the cause of an error of `torch.load` in one line, without its advice to run code of the file."""
    cause = str(error).partition("WeightsUnpickler error:")[2].partition("Check the documentation")[0]
    return shortened(printable(cause or error), 200) or type(error).__name__
