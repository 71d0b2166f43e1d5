"""Install the locked packages and this project into the environment of this Python, with uv.

Both check the hashes of all packages but torch.
uv takes a fifth of pip's time. It does not read pip's configuration: indexes, folders of wheels, constraints and
certificates are passed on as environment variables. Where uv cannot be installed or fails, pip installs the same.
"""

import ast
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

LOCK = "requirements.lock"
PIP = [sys.executable, "-m", "pip"]
QUIET = ["--quiet", "--disable-pip-version-check"]
STEPS = (
    ["--no-deps", "-r", LOCK],
    ["-r", "requirements-torch.lock"],
    ["--no-deps", "--no-build-isolation", "--editable", "."],
)
VARIABLES = {
    "index-url": ("UV_DEFAULT_INDEX", " "),
    "extra-index-url": ("UV_INDEX", " "),
    "find-links": ("UV_FIND_LINKS", ","),
    "constraint": ("UV_CONSTRAINT", " "),
    "cert": ("SSL_CERT_FILE", " "),
    "no-index": ("UV_NO_INDEX", " "),
}
"""Option of pip, variable of uv, and what separates its values."""


def pip_settings(listed: str) -> dict[str, str]:
    """Return the settings that `pip config list` prints; `install` outranks `global`, the environment both."""
    ranked: dict[str, tuple[int, str]] = {}
    for line in listed.splitlines():
        name, _, value = line.partition("=")
        section, _, key = name.rpartition(".")
        rank = {"global": 0, "install": 1, ":env:": 2}.get(section, -1)
        if rank >= ranked.get(key, (0, ""))[0]:
            ranked[key] = rank, ast.literal_eval(value)
    return {key: value for key, (_, value) in ranked.items()}


def uv_environment(settings: dict[str, str]) -> dict[str, str]:
    """Return the variables with which uv uses the settings of pip and, like pip, compares all indexes."""
    given = {
        variable: separator.join(settings[key].split())
        for key, (variable, separator) in VARIABLES.items()
        if settings.get(key)
    }
    return {"UV_INDEX_STRATEGY": "unsafe-best-match", "UV_NO_PROGRESS": "1", **given}


def installs_uv() -> bool:
    """Install the locked uv, whose hash is checked too; return whether that worked."""
    (pin,) = re.findall(r"^uv==(?:.*\\\n)*.*\n", Path(LOCK).read_text(encoding="utf-8"), re.MULTILINE)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, "uv.lock")
        place.write_text(pin, encoding="utf-8")
        return subprocess.run([*PIP, "install", *QUIET, "--quiet", "-r", str(place)], check=False).returncode == 0


def main() -> int:
    """Install with uv, else with pip."""
    listed = subprocess.run([*PIP, "config", "list"], capture_output=True, text=True, check=True).stdout
    environment = {**uv_environment(pip_settings(listed)), **os.environ}
    program = [
        sys.executable,
        "-m",
        "uv",
        "pip",
        "install",
        "--quiet",
        "--compile-bytecode",
        "--python",
        sys.executable,
    ]
    has_uv = installs_uv()
    for step in STEPS:
        if has_uv and subprocess.run([*program, *step], env=environment, check=False).returncode == 0:
            continue
        sys.stderr.write(f"uv could not install {' '.join(step)}; installing with pip ...\n")
        if code := subprocess.run([*PIP, "install", *QUIET, *step], check=False).returncode:
            return code
    # Without compiled sources, imports take three times as long wherever PYTHONDONTWRITEBYTECODE is set.
    return subprocess.run([sys.executable, "-m", "compileall", "-q", "src"], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
