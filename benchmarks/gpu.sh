#!/bin/sh
# All that has to be checked on a GPU, in at most eight minutes:  LOCK=requirements-cuda.lock ./run benchmarks/gpu.sh
#
# At table 1's sizes, what a training step, a plan and an estimate take; then a chain of scale smoke up to its plans.
# Rows with the device's name go to the folder that is given, by default reports/paper/benchmarks/gpu.
set -eu
cd "$(dirname "$0")/.."
folder=${1:-reports/paper/benchmarks/gpu}

name=$(python -c 'import jax; print(jax.devices()[0].device_kind, jax.devices()[0].platform)')
case $name in
  *" cpu") echo "gpu.sh: expected a GPU, JAX found only $name; call it with LOCK=requirements-cuda.lock" >&2; exit 1 ;;
esac
echo "on $name"

timeout 150 python benchmarks/training.py --scale paper --rounds 3 --csv "$folder"
timeout 150 python benchmarks/planning.py main b2 --scale paper --rounds 1 --batch 4 --csv "$folder"

copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
git clone -q . "$copy"
cd "$copy"
sed -i 's/^scale: .*/scale: smoke/' params.yaml
started=$(date +%s)
status=0
PYTHONPATH=src timeout 180 dvc repro -q plan@main || status=$?
seconds=$(($(date +%s) - started))
cd - >/dev/null
printf 'device,stages,seconds,exit status\n%s,plan@main and all before it (smoke),%s,%s\n' "$name" "$seconds" "$status" \
  >"$folder/stages.csv"
cat "$folder/stages.csv"
exit "$status"
