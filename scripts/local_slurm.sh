#!/usr/bin/env bash
# A Slurm of three nodes on this machine, n1 to n3, for trying slurm/*.sbatch; Debian, as root.
#
#     eval "$(bash scripts/local_slurm.sh start FOLDER)"    # exports SLURM_CONF; then sbatch ...
#     bash scripts/local_slurm.sh crash FOLDER n2           # as if the node lost its power
#     bash scripts/local_slurm.sh boot FOLDER n2
#     bash scripts/local_slurm.sh stop FOLDER
#
# A node has 2 CPUs, a host name, processes and shared memory of its own; nodes talk by TCP. Jobs of
# partition `urgent` take the nodes from those of `main`. All files are in FOLDER, daemons listen on
# free ports of 127.0.0.1 and have a munge of their own: no other Slurm is disturbed. Exit status
# 77: cannot be started here, with a sentence that says why.
set -euo pipefail

nodes="n1 n2 n3"

cannot() {
    echo "local Slurm: $*" >&2
    exit 77
}

# whether a process is (still) the program of that name
is() {
    [[ "$(readlink "/proc/$1/exe")" == */"$2"* ]]   # slurmctld-wlm
}

# the process of a pid file, if it is
process_of() {
    local pid
    pid="$(cat "$folder/$1.pid" 2> /dev/null)" && is "$pid" "$2" && echo "$pid"
}

boot() {
    [ -z "$(process_of "$1" unshare)" ] || return 0
    # with the first process of its name space a node ends, whatever runs on it
    setsid unshare --uts --mount --pid --fork --kill-child --mount-proc bash -euc '
        hostname "$1"
        mount --bind "$2/hosts" /etc/hosts
        mount -t tmpfs tmpfs /dev/shm
        slurmd -D -N "$1"; exit    # and bash stays, to collect what others leave behind
    ' bash "$1" "$folder" > "$folder/log/$1.out" 2>&1 < /dev/null &
    echo "$!" > "$folder/$1.pid"
}

crash() {
    local pid
    pid="$(process_of "$1" unshare)" || return 0
    kill -KILL "$pid"
}

stop() {
    local daemon pid
    for node in $nodes; do
        crash "$node"
    done
    for daemon in slurmctld munged; do
        pid="$(process_of "$daemon" "$daemon")" || continue
        kill "$pid"
        for _ in $(seq 50); do
            is "$pid" "$daemon" || continue 2
            sleep 0.1
        done
        kill -KILL "$pid"
    done
}

start() {
    local packages="slurmctld slurmd slurm-client munge libpmix-dev openmpi-bin"
    local missing="" host ports
    [ "$(id -u)" -eq 0 ] || cannot "only root can start it"
    command -v dpkg-query > /dev/null || cannot "it is set up for Debian only"
    unshare --uts --mount --pid --fork --mount-proc true 2> /dev/null ||
        cannot "name spaces of its nodes' own are not allowed here"
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
    [ -z "$(process_of slurmctld slurmctld)" ] || cannot "one is running in $folder"

    read -ra ports <<< "$(python3 - <<PORTS
import socket
sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(4)]
print(*(s.getsockname()[1] for s in sockets))
PORTS
)"
    mkdir -p "$folder"/{state,log}
    (umask 077 && head -c 128 /dev/urandom > "$folder/munge.key")
    { cat /etc/hosts; echo "127.0.0.1 $nodes"; } > "$folder/hosts"
    # what a site of such nodes would tell MPI; /dev/shm is the node's own, other than /tmp
    cat > "$folder/environment" <<ENVIRONMENT
#!/bin/sh
echo export OMPI_MCA_oob_tcp_if_include=lo
echo export OMPI_MCA_btl_tcp_if_include=lo
echo export UCX_NET_DEVICES=lo
echo export TMPDIR=/dev/shm
ENVIRONMENT
    chmod +x "$folder/environment"
    # cred_expire: also the seconds that a requeued job waits, 120 by default, at least 5
    cat > "$SLURM_CONF" <<CONFIGURATION
ClusterName=local
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=${ports[0]}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$folder/munge.socket,cred_expire=5
CredType=cred/munge
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
TaskProlog=$folder/environment
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerType=sched/backfill
SchedulerParameters=batch_sched_delay=0,sched_interval=1,sched_min_interval=0,bf_interval=1
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
SlurmdParameters=config_overrides
SlurmdTimeout=15
KillWait=5
ReturnToService=2
CompleteWait=0
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.%n.pid
StateSaveLocation=$folder/state
SlurmdSpoolDir=/dev/shm/slurmd
TmpFS=/dev/shm
SlurmctldLogFile=$folder/log/slurmctld.log
SlurmdLogFile=$folder/log/slurmd.%n.log
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
JobCompType=jobcomp/none
NodeName=n1 NodeAddr=127.0.0.1 Port=${ports[1]} CPUs=2
NodeName=n2 NodeAddr=127.0.0.1 Port=${ports[2]} CPUs=2
NodeName=n3 NodeAddr=127.0.0.1 Port=${ports[3]} CPUs=2
PartitionName=main Nodes=ALL Default=YES PriorityTier=1
PartitionName=urgent Nodes=ALL PriorityTier=2
CONFIGURATION
    {
        munged --force --key-file="$folder/munge.key" --socket="$folder/munge.socket" \
            --pid-file="$folder/munged.pid" --log-file="$folder/log/munged.log" \
            --seed-file="$folder/munge.seed" && slurmctld
    } > "$folder/log/start.log" 2>&1 || { stop; cannot "a daemon did not start, see $folder/log"; }
    for node in $nodes; do
        boot "$node"
    done
    for _ in $(seq 100); do
        if [ "$(timeout 5 sinfo -h -p main -o '%T %D' 2> /dev/null)" = "idle 3" ]; then
            echo "export SLURM_CONF='$SLURM_CONF'"
            return
        fi
        sleep 0.1
    done
    stop
    cannot "its nodes did not become idle, see $folder/log"
}

usage() {
    echo "usage: bash scripts/local_slurm.sh start|stop FOLDER" >&2
    echo "       bash scripts/local_slurm.sh crash|boot FOLDER NODE" >&2
    exit 2
}

case "$#${1:-}" in 2start | 2stop | 3crash | 3boot) ;; *) usage ;; esac
folder="$(realpath -m "$2")"
export SLURM_CONF="$folder/slurm.conf"
"$1" "${@:3}"
