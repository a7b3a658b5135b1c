#!/bin/sh
# All that has to be checked on a GPU, in one go:  LOCK=requirements-cuda.lock ./run benchmarks/gpu.sh [FOLDER]
#
# At table 1's sizes, what a training step, a plan and an estimate take; then a chain of scale smoke up to its plans.
# The limits of the parts add up to 450 s. A part that fails or reaches its limit does not end the others; each writes
# its rows, which hold the device's name, as they come. FOLDER is by default reports/paper/benchmarks/gpu; stages.csv
# there has the seconds and the exit status of each part (124: it reached its limit).
set -u
cd "$(dirname "$0")/.." || exit 1
mkdir -p "${1:-reports/paper/benchmarks/gpu}" || exit 1
folder=$(cd "${1:-reports/paper/benchmarks/gpu}" && pwd) || exit 1
failed=0

# Run a part within a limit, and write its row.  part NAME SECONDS COMMAND ..
part() {
  what=$1 limit=$2 began=$(date +%s) status=0
  shift 2
  timeout -k 5 "$limit" "$@" || status=$?
  [ "$status" -eq 0 ] || failed=1
  echo "$name,$what,$limit,$(($(date +%s) - began)),$status" >>"$folder/stages.csv"
}

name=$(timeout 40 python -c 'import jax; print(jax.devices()[0].device_kind, jax.devices()[0].platform)') || exit 1
case $name in
  *" cpu") echo "gpu.sh: expected a GPU, JAX found only $name; call it with LOCK=requirements-cuda.lock" >&2; exit 1 ;;
esac
echo "on $name"
echo "device,part,limit s,s,exit status" >"$folder/stages.csv"

part "training steps" 90 python benchmarks/training.py --scale paper --rounds 3 --csv "$folder"
part "plans and estimates" 140 python benchmarks/planning.py main b2 --scale paper --rounds 1 --batch 4 --csv "$folder"

copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
if timeout 20 git clone -q . "$copy" && cd "$copy" && sed -i 's/^scale: .*/scale: smoke/' params.yaml; then
  part "plan@main and all before it (smoke)" 160 env PYTHONPATH=src dvc repro -q plan@main
  cd - >/dev/null || exit 1
else
  failed=1
fi
cat "$folder/stages.csv"
exit "$failed"
