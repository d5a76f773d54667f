#!/usr/bin/env bash
# Sets up what is missing, then checks style and types and runs all tests: serial, on 2 and 3 ranks.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source scripts/setup.sh
# numba looks at a function's own file only: a changed kernel would not be compiled into its callers
find ringwear_par -name '*.nb[ic]' -delete
ruff check .
ruff format --check .
mypy
timeout -k 5 900 python -m pytest -q -rs
for ranks in 2 3; do
    echo "on $ranks ranks"
    # every rank reports; one report is enough where all went well
    log="$(mktemp)"
    if timeout -k 5 600 mpirun -n "$ranks" python -m pytest -q --color=no --with-mpi > "$log" 2>&1; then
        grep -a -m 1 passed "$log"
        rm "$log"
    else
        cat "$log"
        exit 1
    fi
done
