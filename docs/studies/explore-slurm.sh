#!/bin/bash
# A study on a SLURM cluster: one scheduler, a worker per core, and the command that asks them.
#
#   sbatch docs/studies/explore-slurm.sh STUDY.yaml OUT
#
# STUDY.yaml and OUT lie on storage that the first machine of the job sees; workers write nothing but their logs. A job
# that ends too early is submitted again with the same words: it goes on with the parts that are there.
#SBATCH --job-name=dqforge-explore
#SBATCH --ntasks=64
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=1G
#SBATCH --time=04:00:00
#SBATCH --signal=B:TERM@60
# Machines of one kind, without which the same bytes are not promised:
##SBATCH --constraint=skylake
set -eu

study=$1
out=$2
place=${DQFORGE_SCRATCH:-$PWD}/dqforge-${SLURM_JOB_ID:-here}
mkdir -p "$place"
file=$place/scheduler.json

# One thread per process, and memory that is kept: Dask's own setting costs a factor of four. Names in capitals can
# only be set in a file. dqforge finds out by itself which row ends a process, with fewer deaths than Dask takes.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
cat > "$place/dask.yaml" << EOF
distributed:
  scheduler: {allowed-failures: 0}
  nanny:
    pre-spawn-environ: {MALLOC_TRIM_THRESHOLD_: 268435456, MALLOC_MMAP_THRESHOLD_: 268435456}
EOF
export DASK_CONFIG=$place/dask.yaml

# With certificates in $DQFORGE_TLS all three speak TLS, and nobody else on the network is heard.
tls=()
if [ -n "${DQFORGE_TLS:-}" ]; then
    tls=(--tls-ca-file "$DQFORGE_TLS/ca.pem" --tls-cert "$DQFORGE_TLS/own.pem" --tls-key "$DQFORGE_TLS/own.key")
fi

dask scheduler --scheduler-file "$file" --port 0 --no-dashboard "${tls[@]}" ${DQFORGE_TLS:+--protocol tls} \
    > "$place/scheduler.log" 2>&1 &
scheduler=$!
${DQFORGE_LAUNCH:-srun} dask worker --scheduler-file "$file" --nthreads 1 --no-dashboard --death-timeout 120 \
    --local-directory "$place" "${tls[@]}" > "$place/workers.log" 2>&1 &
workers=$!
trap 'kill $scheduler $workers 2> /dev/null || true' EXIT

# The signal before the end of the job reaches the command, which writes what is in hand.
dqforge explore "$study" -o "$out" --scheduler-file "$file" "${tls[@]}" &
command=$!
trap 'kill -TERM $command' TERM
code=0
wait $command || code=$?
exit $code
