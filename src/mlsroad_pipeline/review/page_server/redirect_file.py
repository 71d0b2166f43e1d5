"""File that takes the browser to the page: the address with its token is in no argument, which other users can read."""

import os
import stat
import tempfile
from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ReadError

_CONTENT = """<!DOCTYPE html>
<meta charset="utf-8">
<meta http-equiv="refresh" content="0;url={address}">
<title>mlsroad</title>
<p><a href="{address}">Open the page</a></p>
"""


def redirect_to(address: str = "/") -> str:
    """Return a document that goes on to an address."""
    return _CONTENT.format(address=address)


class RedirectFile:
    """A file of mode 0600 that goes on to an address; it is removed when the address was used."""

    def __init__(self, address: str, folder: Path) -> None:
        number, name = tempfile.mkstemp(prefix="open-", suffix=".html", dir=folder.absolute())
        self.path = Path(name)
        with os.fdopen(number, "w", encoding="utf-8") as stream:
            mode = stat.S_IMODE(os.fstat(number).st_mode)
            if not mode & 0o077:
                stream.write(redirect_to(address))
        if mode & 0o077:  # a file system without permissions
            self.remove()
            raise ReadError(f"{folder} does not keep permissions, so that others could read the address of the page")

    def remove(self) -> None:
        """Remove the file."""
        self.path.unlink(missing_ok=True)
