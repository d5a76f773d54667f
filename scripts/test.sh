#!/usr/bin/env bash
# Sets up what is missing, then checks style and types, builds the site and runs all tests: serial, on 2 and 3 ranks.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source scripts/setup.sh
ruff check .
ruff format --check .
# the programs that tests start are many: each would compile the whole package again
unset PYTHONDONTWRITEBYTECODE
# once, before many processes want it at the same time
python - <<COMPILE
from mpi4py import MPI
from ringwear_par.compiled.machine_code import load
from ringwear_par.compiled.modules import LOOPS
from ringwear_par.elasticity.bem.assembly import load_kernels
for loops in LOOPS:
    load(loops)
load_kernels(MPI.COMM_SELF)
COMPILE
logs="$(mktemp -d)"
# types and the site, with warnings as errors and as a browser shows it, beside the tests, which wait
# for programs now and then
bash scripts/docs.sh --install
in_browser=tests/repository/test_site_in_browser.py
{ mypy && bash scripts/docs.sh && python -m pytest -q -rs "$in_browser"; } > "$logs/site" 2>&1 &
site=$!
trap 'kill "$site" 2>/dev/null || true' EXIT
# limits are for hangs, not for load; files are shared out, as many tests wait for programs (more of
# them at once than there are cores), and taken in order, the slow ones first
timeout -k 5 2400 python -m pytest -q -rs -n 6 --dist loadfile --no-loadscope-reorder --ignore "$in_browser"
wait "$site" || { cat "$logs/site"; exit 1; }
tail -n 1 "$logs/site"
for ranks in 2 3; do
    echo "on $ranks ranks"
    # every rank reports; one report is enough where all went well
    if timeout -k 5 1800 mpirun -n "$ranks" python -m pytest -q --color=no --with-mpi > "$logs/ranks" 2>&1; then
        grep -a -m 1 passed "$logs/ranks"
    else
        cat "$logs/ranks"
        exit 1
    fi
done
rm -r "$logs"
