#!/usr/bin/env bash
# Renew the hashes of requirements.lock after a change of versions.
set -euo pipefail
cd "$(dirname "$0")/.."
lock=requirements.lock
comment=$(grep '^#' $lock)
hashed=$(grep -oE '^[A-Za-z0-9._-]+==[^ ]+' $lock | .venv/bin/uv pip compile - \
    --universal --python-version 3.11 --no-deps --quiet --no-header --no-annotate --generate-hashes)
printf '%s\n%s\n' "$comment" "$hashed" > $lock
