# Sets up what is missing for ringwear-par on Debian: packages, .venv, the package itself.
# Sourced by paper.sh and test.sh; by itself: `source scripts/setup.sh`, then type commands.
# Works as root and as an ordinary user; says in one sentence what it may not do itself.

ringwear_setup() {
    local top python packages missing package stamp
    local mark="# ringwear-par: mpirun as root, more ranks than cores, one thread a rank"
    top="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
    python=/usr/bin/python3
    packages="python3-venv python3-petsc4py python3-petsc4py-real python3-mpi4py python3-scipy python3-h5py-mpi openmpi-bin libopenblas0-pthread"

    missing=""
    for package in $packages; do
        dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q "install ok installed" ||
            missing="$missing $package"
    done
    if [ -n "$missing" ]; then
        local install="apt-get install -y --no-install-recommends$missing"
        if [ "$(id -u)" -eq 0 ]; then
            echo "ringwear setup: installing$missing" >&2
            { apt-get update -qq; DEBIAN_FRONTEND=noninteractive $install >/dev/null; } ||
                { echo "ringwear setup: '$install' failed" >&2; return 1; }
        elif sudo -n true 2>/dev/null; then
            echo "ringwear setup: installing$missing" >&2
            { sudo -n apt-get update -qq; sudo -n DEBIAN_FRONTEND=noninteractive $install >/dev/null; } ||
                { echo "ringwear setup: 'sudo $install' failed" >&2; return 1; }
        else
            echo "ringwear setup: Debian packages are missing and you may not install them; ask for: sudo $install" >&2
            return 1
        fi
    fi

    stamp="$top/.venv/ringwear-$(cksum < "$top/pyproject.toml" | cut -d' ' -f1)"
    if [ ! -e "$stamp" ]; then
        if [ ! -w "$top" ]; then
            echo "ringwear setup: $top is not yours to write in; clone the repository to a folder of your own" >&2
            return 1
        fi
        if [ ! -x "$top/.venv/bin/pip" ]; then
            "$python" -m venv --clear --system-site-packages "$top/.venv" || return 1
        fi
        # Debian keeps petsc4py beside its PETSc, out of Python's sight; pip must see it too, or it
        # would start to build another PETSc
        echo "import glob, sys; sys.path += sorted(glob.glob('/usr/lib/petscdir/petsc3*/*-real/lib/python3/dist-packages'))[-1:]" \
            > "$("$top/.venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/debian-petsc.pth"
        "$top/.venv/bin/python" -c 'from petsc4py import PETSc' ||
            { echo "ringwear setup: Debian's petsc4py does not load" >&2; return 1; }
        # petsc4py and scipy of Debian 12 are built for numpy 1
        local numpy="numpy"
        case "$("$python" -c 'import numpy; print(numpy.__version__)')" in 1.*) numpy="numpy<2" ;; esac
        "$top/.venv/bin/pip" install -q --disable-pip-version-check -e "$top[test]" "$numpy" ||
            { echo "ringwear setup: pip could not install the Python packages" >&2; return 1; }
        if ! grep -qF "$mark" "$top/.venv/bin/activate"; then
            cat >> "$top/.venv/bin/activate" <<ACTIVATE

$mark
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
export OMPI_MCA_rmaps_base_oversubscribe=1
export OMPI_MCA_hwloc_base_binding_policy=none PRTE_MCA_hwloc_default_binding_policy=none
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1
ACTIVATE
        fi
        touch "$stamp"
    fi
    source "$top/.venv/bin/activate"
}

ringwear_setup
