#!/usr/bin/env bash
# The cluster examples against runs in one piece, byte for byte. Called by ./test cluster.
# Usage: check.sh PROGRAM PYTHON|none FOLDER
set -euo pipefail

program=$(realpath "$1") python=$2 folder=$3
here=$(cd "$(dirname "$0")" && pwd)
slurm=$here/../../examples/cluster/slurm
ray=$here/../../examples/cluster/ray/shards.py
rm -rf "$folder"
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)

for script in "$slurm"/*.sh "$here"/sbatch "$here"/check.sh; do bash -n "$script"; done

# Small, and each of its kind: samples with loads, a study with rows that share a generator, two blind cases. The
# finder is a few lines of shell: what is tested is that all its verdicts are scored once.
dataset=(--samples 400 --seed 9 --payload-max 0.5)
study=(coverage --seconds 5)
cat >"$folder/finder" <<'FINDER'
#!/bin/sh
echo '{"verdict": "nothing-missing", "effects": [], "seconds": 1.5}'
FINDER
chmod +x "$folder/finder"
bench=(--seeds 1 --first-seed 3 --only "nulls,ladder" --seconds 8 --finder "$folder/finder")

whole=$folder/whole
mkdir -p "$whole"
"$program" dataset generate "${dataset[@]}" --out "$whole/dataset.parquet" >/dev/null
"$program" study "${study[@]}" --out "$whole" >/dev/null 2>&1
"$program" gap bench "${bench[@]}" --out "$whole" >/dev/null 2>&1

compare() {
    for name in dataset.parquet coverage.json coverage.md coverage.svg report.json report.md; do
        cmp "$whole/$name" "$folder/$1/$name"
    done
    echo "$1: the same bytes as in one piece: data set, study, blind test"
}

export SBATCH_STANDIN=$folder/jobs
mkdir -p "$SBATCH_STANDIN"
submit() { PATH="$here:$PATH" SPRINGTWIN=$program "$slurm/submit.sh" "$@"; }
submit dataset 11 "$folder/slurm" "${dataset[@]}"
submit study 3 "$folder/slurm" "${study[@]}"
# Shards of the study lie in that folder, too: each merge has to find its own.
submit gap-bench 2 "$folder/slurm" "${bench[@]}"
compare slurm
# A shard that fails keeps the merge from running.
if submit study 2 "$folder/refused" no-such-study 2>/dev/null; then
    echo "error: a merge ran after a shard that had failed" >&2
    exit 1
fi

if [ "$python" = none ]; then
    echo "left out: the Ray example"
    exit 0
fi
# A program whose second shard fails the first time it is tried.
cat >"$folder/springtwin" <<PROGRAM
#!/bin/sh
case "\$*" in
*"generate"*"--shard 2/"*)
    if mkdir "$folder/has-failed" 2>/dev/null; then
        echo "error: out of luck" >&2
        exit 1
    fi
    ;;
esac
exec "$program" "\$@"
PROGRAM
chmod +x "$folder/springtwin"
run_ray() { "$python" "$ray" --cpus 1 --out "$folder/ray" --program "$folder/springtwin" "$@" >/dev/null; }
run_ray --shards 3 dataset "${dataset[@]}"
[ -d "$folder/has-failed" ] || {
    echo "error: no shard failed, so nothing was tried again" >&2
    exit 1
}
run_ray --shards 3 study "${study[@]}"
run_ray --shards 2 gap-bench "${bench[@]}"
compare ray
# A shard that keeps failing ends the run with a sentence that names it.
if run_ray --shards 2 --retries 1 study no-such-study 2>"$folder/complaint"; then
    echo "error: a study that does not exist was made" >&2
    exit 1
fi
grep -q "^error: after 2 tries each, these shards failed: .*no-such-study" "$folder/complaint"
