#!/usr/bin/env bash
# Renew the hashes of the locked packages after a change of versions.
set -euo pipefail
cd "$(dirname "$0")/.."
for lock in requirements.lock requirements-label.lock; do
    hashed=$(grep -oE '^[A-Za-z0-9._-]+==[^ ]+' "$lock" |
        .venv/bin/uv pip compile - --universal --python-version 3.11 --no-deps --quiet --no-header --no-annotate --generate-hashes)
    comment=$(grep '^#' "$lock")
    printf '%s\n%s\n' "$comment" "$hashed" > "$lock"
done
