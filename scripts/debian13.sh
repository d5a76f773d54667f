#!/usr/bin/env bash
# The same checkout under Debian 13, in a chroot of its own; root only, elsewhere skipped (status 77).
# Usage: bash scripts/debian13.sh [FOLDER [COMMAND...]]
# FOLDER (default: /var/tmp/ringwear-debian13) is made where it is missing (0.3 GB, 3 GB with all packages) and
# kept for the next call; COMMAND (default: bash scripts/test.sh) runs in a fresh copy of the checkout in it, with
# processes and mounts that end with this script. For another release or mirror: SUITE=..., MIRROR=...
set -euo pipefail
top="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
root="${1:-/var/tmp/ringwear-debian13}"
shift || true
suite="${SUITE:-trixie}" mirror="${MIRROR:-http://deb.debian.org/debian}"

skip() {
    echo "debian13: skipped: $1" >&2
    exit 77
}
[ "$(id -u)" -eq 0 ] || skip "only root can make a chroot"
unshare --mount --pid --fork true 2>/dev/null || skip "this machine allows no namespaces for processes and mounts"
mkdir -p "$root"
exec 9> "$root/lock"
flock -n 9 || skip "another call is at work in $root"
if [ ! -e "$root/debootstrap-done" ]; then
    command -v debootstrap > /dev/null || skip "debootstrap is missing: apt-get install debootstrap"
    debootstrap --variant=minbase --include=ca-certificates,procps "$suite" "$root" "$mirror" > "$root/debootstrap.log" 2>&1 ||
        skip "debootstrap could not install $suite from $mirror (see $root/debootstrap.log)"
    touch "$root/debootstrap-done"
fi
# the way to the packages is this machine's: names, certificates, pip's settings
for file in /etc/resolv.conf /etc/hosts /etc/pip.conf /etc/ssl/certs/ca-certificates.crt; do
    [ ! -e "$file" ] || cp -L "$file" "$root$file"
done
# a fresh copy of what git knows or would add; what setup.sh has made stays
checkout="$root/root/ringwear-par"
mkdir -p "$checkout"
find "$checkout" -mindepth 1 -maxdepth 1 ! -name .venv ! -name '*.egg-info' -exec rm -rf {} +
(cd "$top" && git ls-files -z --cached --others --exclude-standard | tar --null --files-from - -c) | tar -x -C "$checkout"

[ $# -gt 0 ] || set -- bash scripts/test.sh
exec unshare --mount --propagation private --pid --fork --kill-child bash -c '
    root="$1"
    shift
    mount -t proc proc "$root/proc"
    mount -t sysfs -o ro sysfs "$root/sys"
    mount -t tmpfs tmpfs "$root/dev/shm"
    mount -t devpts -o newinstance,ptmxmode=0666 devpts "$root/dev/pts"
    exec chroot "$root" /usr/bin/env -u PYTHONPATH -u VIRTUAL_ENV -u PIP_FIND_LINKS PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root \
        bash -c "cd /root/ringwear-par && \"\$@\"" - "$@"
' - "$root" "$@"
