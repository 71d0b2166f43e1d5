"""Text of files and of other people on a terminal and in a log."""

from __future__ import annotations


def printable(text: object) -> str:
    """Return a text as one line without control characters.

    Parameters
    ----------
    text : object
        A text, or an object with one, such as an error.

    Returns
    -------
    str
        The text with single blanks in place of white space; control characters, which move the cursor or colour a
        terminal, and undecodable bytes of file names are escaped.

    Examples
    --------
    >>> printable("a\\x1b[31m\\nb.laz")
    'a\\\\x1b[31m b.laz'
    """
    line = " ".join(str(text).split())
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
