#!/usr/bin/env bash
# Measure MyoWarp on the GPU of a machine without internet, from a kit that `make gpu-kit` has made.
#   gpu_run.sh KIT OUT [OPTION...]     options are those of `python -m benchmarks.gpu`
#   PYTHON=python3.12                  interpreter; it has torch where torch is to be measured
# Parts may come one by one: put them into one folder first. OUT/gpu.json is written after each answer.
set -euo pipefail
mkdir -p "$2"
kit=$(realpath "$1") out=$(realpath "$2")
shift 2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python=${PYTHON:-python3.12}
cat "$kit"/part* | "$python" -c '
import sys, tarfile
tarfile.open(fileobj=sys.stdin.buffer, mode="r|xz").extractall(sys.argv[1], filter="data")' "$work"
cd "$work"
export PYTHONPATH="$work/site:$work" XDG_CACHE_HOME="$work/cache" WARP_CACHE_PATH="$work/warp" PYTHONUNBUFFERED=1
"$python" -m benchmarks.gpu --references references.npz --output "$out/gpu.json" "$@"
