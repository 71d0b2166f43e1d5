"""Commands that the README and the manual give, as argument lists."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import NamedTuple

from helpers.wiring import REPOSITORY

PROGRAMS = ("kedro", "mlsroad")
_FENCE = re.compile(r"```[^\n]*\n(.*?)```", re.DOTALL)
_INLINE = re.compile(r"`((?:\.venv/bin/)?(?:kedro run|mlsroad) [^`\n]+)`")


class Command(NamedTuple):
    """A command with the page that gives it."""

    page: str
    text: str
    arguments: tuple[str, ...]


def pages() -> list[Path]:
    """Return the README and the pages of the manual."""
    return [REPOSITORY / "README.md", REPOSITORY / "CONTRIBUTING.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]


def _candidates(text: str) -> list[str]:
    blocks = [line for block in _FENCE.findall(text) for line in block.replace("\\\n", " ").splitlines()]
    rest = _FENCE.sub("", text)
    indented = [line for line in rest.splitlines() if line.startswith("    ")]
    return [*blocks, *indented, *_INLINE.findall(rest)]


def documented_commands() -> list[Command]:
    """Return each command of `PROGRAMS` once, the program without its folder."""
    found: dict[tuple[str, ...], Command] = {}
    for page in pages():
        for line in _candidates(page.read_text(encoding="utf-8")):
            text = re.sub(r"^[\s$]*(?:[A-Z_]+=\S+ )*", "", line)
            match = re.match(r"(?:\S*/)?(\w+) (.*)", text)
            if match is None or match[1] not in PROGRAMS:
                continue
            for part in re.split(r" && ", match[0]):
                words = [word for word in shlex.split(part, comments=True) if word != "..."]
                arguments = (words[0].rpartition("/")[2], *words[1:])
                if arguments[0] in PROGRAMS and arguments not in found:
                    found[arguments] = Command(str(page.relative_to(REPOSITORY)), part, arguments)
    return list(found.values())
