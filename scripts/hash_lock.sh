#!/usr/bin/env bash
# Renews the hashes of the locks after a change of versions.
set -euo pipefail
cd "$(dirname "$0")/.."
for lock in requirements.lock requirements-label.lock; do
    comment=$(grep '^#' $lock)
    hashed=$(grep -oE '^[A-Za-z0-9._-]+==[^ ]+' $lock | .venv/bin/uv pip compile - \
        --universal --python-version 3.11 --no-deps --quiet --no-header --no-annotate --generate-hashes)
    printf '%s\n%s\n' "$comment" "$hashed" > $lock
done
