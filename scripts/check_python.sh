#!/usr/bin/env bash
# Run the tests of `make quick` with another Python and the newest packages that pyproject.toml allows, in a scratch environment.
#   scripts/check_python.sh python3.13 [OPTION OF PYTEST]...
set -euo pipefail
cd "$(dirname "$0")/.."
[ $# -gt 0 ] || { printf 'usage: scripts/check_python.sh PYTHON [OPTION OF PYTEST]...\n' >&2; exit 2; }
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
"$1" -m venv "$scratch"
"$scratch/bin/python" -m pip install --quiet --upgrade-strategy eager --editable '.[dev]'
"$scratch/bin/python" -m pip list --format=freeze
export PATH=$scratch/bin:$PATH
python -m pytest -n auto --dist loadfile --no-loadscope-reorder -m "not slow and not process and not training" "${@:2}"
