#!/usr/bin/env bash
# Submits an array job of SHARDS tasks and, after all of them, their merge.
# Usage: submit.sh dataset|study|gap-bench SHARDS OUT [option of the command ...]
#   submit.sh dataset 20 data --samples 100000 --seed 1
#   submit.sh study 60 studies all
#   submit.sh gap-bench 38 bench --seeds 30
# OUT has to lie where all nodes see it, the program too (on the PATH, or named by SPRINGTWIN). Partition, account
# and times go into SBATCH_PARTITION, SBATCH_ACCOUNT, SBATCH_TIMELIMIT, or into the head of shard.sh.
set -euo pipefail

[ $# -ge 3 ] || {
    sed -n '2,6p' "$0" >&2
    exit 2
}
kind=$1 shards=$2 out=$3
shard=$(cd "$(dirname "$0")" && pwd)/shard.sh
mkdir -p "$out"
out=$(cd "$out" && pwd)

array=$(sbatch --parsable --array="1-$shards" --output="$out/%A-%a.log" "$shard" "$kind" "$shards" "$out" "${@:4}")
array=${array%%;*} # "job;cluster" on a federation
# A shard that failed can be done again alone: sbatch --array=7 with the same arguments; then the merge.
merge=$(sbatch --parsable --dependency="afterok:$array" --kill-on-invalid-dep=yes --output="$out/%j.log" \
    "$shard" "$kind" "$shards" "$out" "${@:4}")
echo "shards: job $array; merge: job ${merge%%;*}; logs and results in $out"
