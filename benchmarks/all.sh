#!/bin/sh
# The rows of benchmarks that documentation quotes, in one go:  ./run benchmarks/all.sh [SCENES]
#
# Writes to reports/laptop/benchmarks, but what is measured at table 1's sizes to reports/paper/benchmarks. SCENES is
# the folder of ARCSim's scenes that benchmarks/likeness.py takes; without it there are no rows of likeness. Nothing
# else should run on the machine meanwhile. A part that fails does not end the others; the exit status tells of it.
set -u
cd "$(dirname "$0")/.." || exit 1
rows=reports/laptop/benchmarks paper=reports/paper/benchmarks failed=0

part() {
  began=$(date +%s)
  python "$@" || { failed=1; echo "all.sh: failed: $*" >&2; }
  echo "$(($(date +%s) - began)) s: $*"
}

part benchmarks/minutes.py c2bc70f --csv "$rows"
part benchmarks/startup.py --csv "$rows"
part benchmarks/simulation.py steps --csv "$rows"
part benchmarks/simulation.py sequences --sizes 16 --csv "$rows"
part benchmarks/simulation.py blocks --count 32 --csv "$rows"
if [ $# -gt 0 ]; then
  part benchmarks/likeness.py "$1" --csv "$rows"
fi
part benchmarks/million.py 4000 8000 --csv "$rows"
part benchmarks/million.py 4000 8000 --dask 2 --csv "$rows"
part benchmarks/training.py --scale laptop --csv "$rows"
part benchmarks/planning.py main b3 b2 --scale laptop --rounds 1 --csv "$rows"
part benchmarks/training.py --scale paper --steps 4 --rounds 2 --csv "$paper"
part benchmarks/paper_hours.py "$paper" --simulation "$rows/simulation_steps.csv" --csv "$paper"
exit "$failed"
