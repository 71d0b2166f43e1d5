"""Files in YAML, parsed once per process and with libyaml; PyYAML's own parser takes longer than most tests."""

import functools
import pickle
from pathlib import Path
from typing import Any

import yaml


@functools.cache
def _parsed(path: Path) -> bytes:
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    return pickle.dumps(yaml.load(path.read_text(encoding="utf-8"), Loader=loader))


def read_yaml(path: Path) -> Any:
    """Return the content of a file of the repository, which no test changes."""
    return pickle.loads(_parsed(path))
