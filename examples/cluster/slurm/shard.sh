#!/usr/bin/env bash
# One task of an array job: shard SLURM_ARRAY_TASK_ID of SHARDS. Without an array: the merge.
# Handed to sbatch by submit.sh. Usage: shard.sh dataset|study|gap-bench SHARDS OUT [option ...]
#SBATCH --job-name=springtwin
#SBATCH --cpus-per-task=8
#SBATCH --mem=8G
#SBATCH --time=04:00:00
#SBATCH --requeue
set -euo pipefail

kind=$1 shards=$2 out=$3
shift 3
springtwin=${SPRINGTWIN:-springtwin}
i=${SLURM_ARRAY_TASK_ID:-}
mkdir -p "$out/shards"

# A task that was requeued replaces what it wrote before: --overwrite.

case $kind in
dataset)
    if [ -n "$i" ]; then
        "$springtwin" dataset generate "$@" --overwrite --shard "$i/$shards" --out "$out/shards/$i.parquet"
    else
        files=()
        for k in $(seq "$shards"); do files+=("$out/shards/$k.parquet"); done
        "$springtwin" dataset merge "${files[@]}" --overwrite --out "$out/dataset.parquet"
    fi
    ;;
study)
    # The first option is the study's name.
    if [ -n "$i" ]; then
        "$springtwin" study "$@" --overwrite --shard "$i/$shards" --out "$out/shards"
    else
        "$springtwin" study merge "$out/shards/$1-"*"-of-$shards.json" --overwrite --out "$out"
    fi
    ;;
gap-bench)
    if [ -n "$i" ]; then
        "$springtwin" gap bench "$@" --overwrite --shard "$i/$shards" --out "$out/shards"
    else
        "$springtwin" gap bench merge "$out/shards/shard-"*"-of-$shards.json" --overwrite --out "$out"
    fi
    ;;
*)
    echo "error: '$kind' is none of dataset, study, gap-bench" >&2
    exit 2
    ;;
esac
