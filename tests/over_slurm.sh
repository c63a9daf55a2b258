#!/bin/bash
# over_slurm.sh COLMAP: the files of examples/slurm under a real Slurm. Starts one of
# its own (slurmctld, two slurmd, munged) on this machine, in a scratch folder, and
# ends it. COLMAP must be built with MPI. Exit code 77, with a line, where Slurm or
# Open MPI is not installed (Debian: slurm-wlm, munge, openmpi-bin).
set -euo pipefail

colmap=$(realpath "$1")
examples=$(cd "$(dirname "${BASH_SOURCE[0]}")/../examples/slurm" && pwd -P)
PATH=$PATH:/usr/sbin
for program in slurmctld slurmd munged sbatch mpirun jq; do
  command -v $program >/dev/null || { echo "SKIPPED: no $program" && exit 77; }
done
work=$(mktemp -d)
cd "$work"
export SLURM_CONF=$work/slurm.conf

fail() {
  echo "FAILED: $*" >&2
  exit 1
}

stop() {
  scontrol shutdown >/dev/null 2>&1 || true
  munged --stop --socket="$work/munge/socket" --pid-file="$work/munge/pid" >/dev/null 2>&1 || true
  for _ in {1..50}; do
    pgrep -f "slurm(d|ctld) -f $work" >/dev/null || break
    sleep 0.1
  done
  rm -rf "$work"
}
trap stop EXIT

# A cluster of two nodes that are both this machine.
start() {
  local user
  user=$(id -un)
  mkdir -m 700 munge
  mkdir state n1 n2
  head -c 1024 /dev/urandom >munge/key
  chmod 400 munge/key
  munged --force --key-file="$work/munge/key" --socket="$work/munge/socket" \
    --pid-file="$work/munge/pid" --log-file="$work/munge/log" --seed-file="$work/munge/seed"
  cat >slurm.conf <<CONF
ClusterName=test
SlurmctldHost=$(hostname)(127.0.0.1)
SlurmUser=$user
SlurmdUser=$user
AuthType=auth/munge
AuthInfo=socket=$work/munge/socket
SlurmctldPort=17817
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/%n
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/%n.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
KillWait=5
NodeName=n1 NodeHostname=$(hostname) NodeAddr=127.0.0.1 Port=17821 CPUs=2 RealMemory=4000
NodeName=n2 NodeHostname=$(hostname) NodeAddr=127.0.0.1 Port=17822 CPUs=2 RealMemory=4000
PartitionName=all Nodes=ALL Default=YES State=UP
CONF
  slurmctld -f "$SLURM_CONF"
  slurmd -f "$SLURM_CONF" -N n1
  slurmd -f "$SLURM_CONF" -N n2
  for _ in {1..100}; do
    [[ $(sinfo -h -t idle -o %D 2>/dev/null) != 2 ]] || return 0
    sleep 0.1
  done
  fail "Slurm does not start: $(tail -n 5 slurmctld.log n1.log)"
}

# submit NAME OPTION...: waits for the job; its exit code is that of the job.
submit() {
  sbatch --wait --quiet --output "$work/$1.%a.txt" --cpus-per-task 1 --mem 1G "${@:2}" \
    "$examples/$1.sbatch"
}

same_frames() {
  diff -r --exclude triangulation.json --exclude database.db one/frames "$1" ||
    fail "$2: the frames differ from those of one process"
}

start
export COLMAP=$colmap OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
"$colmap" multi_frame_simulator --output_path simulated --Simulator.num_cameras 8 \
  --Simulator.num_frames 6 --Simulator.image_width 320 --Simulator.image_height 240 \
  --Simulator.quiet 1
mkdir one mpi array
for folder in mpi array; do cp -r simulated/{images,rig} $folder; done
"$colmap" multi_frame_triangulator --image_path simulated/images \
  --extrinsics_path simulated/rig --output_path one/frames >log.txt 2>&1 || fail "$(cat log.txt)"
"$colmap" multi_frame_intrinsics_refiner --image_path simulated/images --input_path one/frames \
  --extrinsics_path simulated/rig --output_path one/refined \
  --MultiFrame.dense_features none >log.txt 2>&1 || fail "$(cat log.txt)"

# Two machines, a process on each.
export CAPTURE=$work/mpi
submit triangulate --nodes 2 || fail "exit code $?: $(cat triangulate.*.txt)"
same_frames mpi/frames "triangulate.sbatch"
submit refine --nodes 2 || fail "exit code $?: $(cat refine.*.txt)"
[[ $(jq '.peak_rss_bytes_of_processes | length' mpi/refined/summary.json) == 2 ]] ||
  fail "not two processes"
jq -rs '[map([.cameras[] | .params[0]]) | transpose[] | .[0] - .[1] | fabs] | max
  | "refined by two processes and by one: focal lengths differ by at most \(.) px"' \
  {one,mpi}/refined/summary.json

# An error of one process is the job's, with its exit code.
code=0
rm -r mpi/frames/frame000003/sparse/0/points3D.bin
submit refine --nodes 2 || code=$?
[[ $code == 2 ]] || fail "exit code $code of a job with a damaged frame"
grep -q "ERROR: .*frame000003" refine.*.txt || fail "$(cat refine.*.txt)"
[[ -f mpi/refined/summary.json ]] || fail "the earlier result is gone"

# An array in which one job fails: the frames of the others stay, and the next array
# makes what is missing.
export CAPTURE=$work/array
mkdir damaged
mv array/images/frame000001/* damaged
code=0
submit triangulate_array --array 0-5 || code=$?
[[ $code == 2 ]] || fail "exit code $code of an array with a job that failed"
[[ $(find array/frames -name triangulation.json | wc -l) == 5 ]] || fail "not five frames"
mv damaged/* array/images/frame000001
rm triangulate_array.*.txt
submit triangulate_array --array 0-5 || fail "$(cat triangulate_array.*.txt)"
same_frames array/frames "triangulate_array.sbatch"
[[ $(cat triangulate_array.*.txt | grep -c "finished before") == 5 ]] ||
  fail "frames were made again: $(cat triangulate_array.*.txt)"
echo "An array of six jobs, one of which failed: five frames stayed, the next array made one"
