#!/usr/bin/env bash
# The paper's figure 2: sets up what is missing, then computes both thresholds on 2 ranks and draws
# them. Usage: bash scripts/paper.sh [FOLDER]   (default: out)
set -euo pipefail
top="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
source "$top/scripts/setup.sh"
out="${1:-$top/out}"
mkdir -p "$out"
cd "$out"
for p0 in 40 0; do
    mpirun -n 2 ringwear run "$top/scripts/cases/paper.toml" -o "p0_$p0.h5" --set "wear.lower.p0=$p0" --restart
    echo
done
ringwear plot p0_40.h5 p0_0.h5 -o figure2.png --panels wear,penetration --steps 1,50,100,150,200
ringwear plot p0_40.h5 p0_0.h5 -o pressure.png --panels pressure --steps 1,50,100,150,200
echo "results and figures: $out/p0_40.h5, p0_0.h5, figure2.png, pressure.png"
