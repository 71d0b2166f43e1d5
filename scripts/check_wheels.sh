#!/usr/bin/env bash
# Check that every dependency has a wheel for the given versions of Python (default: 3.11 3.12 3.13) on Linux x86-64.
# pip resolves the dependencies of pyproject.toml without installing them; only metadata are downloaded. Needs a network.
set -euo pipefail
cd "$(dirname "$0")/.."
python=.venv/bin/python
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

"$python" -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["dependencies"], sep="\n")' > "$scratch/dependencies.txt"

[ $# -gt 0 ] || set -- 3.11 3.12 3.13
for version in "$@"; do
    "$python" -m pip install --quiet --dry-run --ignore-installed --report "$scratch/$version.json" --target "$scratch/none" \
        --only-binary=:all: --python-version "$version" -r "$scratch/dependencies.txt"
    "$python" - "$version" "$scratch/$version.json" <<'PYTHON'
import json
import sys

version, report = sys.argv[1:]
files = [package["download_info"]["url"].rsplit("/", 1)[-1] for package in json.load(open(report))["install"]]
wheels = [name for name in files if name.endswith(".whl")]
compiled = sorted(name for name in wheels if not name.endswith("-none-any.whl"))
assert len(wheels) == len(files), set(files) - set(wheels)
print(f"Python {version}: {len(files)} packages, all as wheels, {len(compiled)} of them compiled:")
print("  " + " ".join("-".join(name.split("-")[:2]) for name in compiled))
PYTHON
done
