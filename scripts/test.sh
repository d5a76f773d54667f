#!/usr/bin/env bash
# Sets up what is missing, then checks style and types, builds the site and runs all tests: serial, on 2 and 3 ranks.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source scripts/setup.sh
ruff check .
ruff format --check .
mypy
# the programs that tests start are many: each would compile the whole package again
unset PYTHONDONTWRITEBYTECODE
# once, before many processes want it at the same time
python - <<COMPILE
from mpi4py import MPI
from ringwear_par.elasticity.bem.assembly import load_kernels
load_kernels(MPI.COMM_SELF)
COMPILE
# the site, with warnings as errors: every page, formula, link and script of the gallery
bash scripts/docs.sh
# limits are for hangs, not for load; files are shared out, as most tests wait for programs, and taken
# in order, the slow ones first
timeout -k 5 2400 python -m pytest -q -rs -n 4 --dist loadfile --no-loadscope-reorder
for ranks in 2 3; do
    echo "on $ranks ranks"
    # every rank reports; one report is enough where all went well
    log="$(mktemp)"
    if timeout -k 5 1800 mpirun -n "$ranks" python -m pytest -q --color=no --with-mpi > "$log" 2>&1; then
        grep -a -m 1 passed "$log"
        rm "$log"
    else
        cat "$log"
        exit 1
    fi
done
