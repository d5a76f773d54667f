#!/usr/bin/env bash
# A Slurm of one node on this machine, for trying slurm/*.sbatch; Debian, as root.
#
#     eval "$(bash scripts/local_slurm.sh start FOLDER)"    # exports SLURM_CONF; then sbatch ...
#     bash scripts/local_slurm.sh stop FOLDER
#
# All its files are in FOLDER, it listens on free ports of 127.0.0.1 and has a munge of its own: it
# disturbs no other Slurm. Exit status 77: cannot be started here, with a sentence that says why.
set -euo pipefail

cannot() {
    echo "local Slurm: $*" >&2
    exit 77
}

# the process of a pid file, if it is (still) the daemon of that name
process_of() {
    local pid
    pid="$(cat "$folder/$1.pid" 2> /dev/null)" &&
        [[ "$(readlink "/proc/$pid/exe")" == */"$1"* ]] && echo "$pid"
}

stop() {
    local daemon pid
    if [ -n "$(process_of slurmctld)" ]; then
        # daemons leave jobs running
        timeout 5 scancel --full --signal=KILL -u root 2> /dev/null || true
        timeout 5 scancel -u root 2> /dev/null || true
        for _ in $(seq 50); do
            [ -n "$(timeout 5 squeue -h 2> /dev/null)" ] || break
            sleep 0.2
        done
    fi
    for daemon in slurmd slurmctld munged; do
        pid="$(process_of "$daemon")" || continue
        kill "$pid"
        for _ in $(seq 50); do
            [ -n "$(process_of "$daemon")" ] || break
            sleep 0.1
        done
        [ -z "$(process_of "$daemon")" ] || kill -KILL "$pid"
    done
}

start() {
    local packages="slurmctld slurmd slurm-client munge libpmix-dev openmpi-bin"
    local missing="" host cores ports
    [ "$(id -u)" -eq 0 ] || cannot "only root can start it"
    command -v dpkg-query > /dev/null || cannot "it is set up for Debian only"
    for package in $packages; do
        dpkg-query -W -f='${Status}' "$package" 2> /dev/null | grep -q "install ok installed" ||
            missing="$missing $package"
    done
    if [ -n "$missing" ]; then
        echo "local Slurm: installing$missing" >&2
        export DEBIAN_FRONTEND=noninteractive
        local install="apt-get -qq -o Acquire::Retries=0 install -y --no-install-recommends"
        # what may take long only downloads; the lists are often there and recent enough
        {
            timeout 40 $install --download-only $missing ||
                { timeout 20 apt-get -qq update && timeout 40 $install --download-only $missing; }
        } > /dev/null 2>&1 && $install $missing > /dev/null 2>&1 ||
            cannot "packages are missing and apt-get does not install them:$missing"
    fi
    host="$(hostname -s)"
    getent hosts "$host" > /dev/null || cannot "the name of this machine, $host, does not resolve"
    [ -z "$(process_of slurmctld)" ] || cannot "one is running in $folder"

    cores="$(nproc --all)"
    ports="$(python3 - <<PORTS
import socket
sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]
print(*(s.getsockname()[1] for s in sockets))
PORTS
)"
    mkdir -p "$folder"/{state,spool,log}
    (umask 077 && head -c 128 /dev/urandom > "$folder/munge.key")
    # cred_expire: also the seconds that a requeued job waits, 120 by default, at least 5
    cat > "$SLURM_CONF" <<CONFIGURATION
ClusterName=local
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=${ports% *}
SlurmdPort=${ports#* }
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$folder/munge.socket,cred_expire=5
CredType=cred/munge
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerType=sched/backfill
SchedulerParameters=batch_sched_delay=0,sched_interval=1,sched_min_interval=0,bf_interval=1
SlurmdParameters=config_overrides
ReturnToService=2
CompleteWait=0
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldLogFile=$folder/log/slurmctld.log
SlurmdLogFile=$folder/log/slurmd.log
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
JobCompType=jobcomp/none
NodeName=$host NodeAddr=127.0.0.1 CPUs=$((cores < 4 ? 4 : cores)) State=UNKNOWN
PartitionName=main Nodes=$host Default=YES MaxTime=INFINITE State=UP OverSubscribe=YES
CONFIGURATION
    {
        munged --force --key-file="$folder/munge.key" --socket="$folder/munge.socket" \
            --pid-file="$folder/munged.pid" --log-file="$folder/log/munged.log" \
            --seed-file="$folder/munge.seed" && slurmctld && slurmd
    } > "$folder/log/start.log" 2>&1 || { stop; cannot "a daemon did not start, see $folder/log"; }
    for _ in $(seq 100); do
        if [ "$(timeout 5 sinfo -h -o %T 2> /dev/null)" = idle ]; then
            echo "export SLURM_CONF='$SLURM_CONF'"
            return
        fi
        sleep 0.1
    done
    stop
    cannot "its node did not become idle, see $folder/log"
}

if [ $# -ne 2 ] || { [ "$1" != start ] && [ "$1" != stop ]; }; then
    echo "usage: bash scripts/local_slurm.sh start|stop FOLDER" >&2
    exit 2
fi
folder="$(realpath -m "$2")"
export SLURM_CONF="$folder/slurm.conf"
"$1"
