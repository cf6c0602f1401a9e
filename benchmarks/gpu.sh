#!/usr/bin/env bash
# MyoWarp on a GPU in one call of less than eight minutes, on a machine with python3, its venv module, a driver
# and this checkout; writes out/gpu.json.
#   benchmarks/gpu.sh [WHEELS [OPTION...]]   WHEELS: folder of wheels for a machine without internet, or ''
#   VENV=... OUT=... PYTHON=... TIME=470     environment to use, folder to write to, interpreter, seconds in all
# Options are those of `python -m benchmarks.gpu`; `benchmarks/gpu.sh '' --device cpu --sizes 16` is a dry run.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

wheels=${1:-${WHEELS:-}}
shift $(($# > 0))
python=${PYTHON:-python3} environment=${VENV:-.venv} out=${OUT:-out} time=${TIME:-470}
mkdir -p "$out"

if [[ ! -x $environment/bin/python ]]; then
  environment=$(mktemp -d)
  trap 'rm -rf "$environment"' EXIT
  "$python" -m venv "$environment"
  # What the interpreter has already, torch above all, need not be installed again.
  have=$("$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
  echo "$have" >"$("$environment/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/have.pth"
  mapfile -t needed < <("$python" -c '
import tomllib
project = tomllib.load(open("pyproject.toml", "rb"))["project"]
tests = [line for line in project["optional-dependencies"]["dev"] if line.startswith("pytest>")]
print(*project["dependencies"], *tests, sep="\n")')
  "$environment/bin/python" -m pip install --quiet --disable-pip-version-check --no-input \
    ${wheels:+--no-index --find-links "$wheels"} "${needed[@]}"
fi
run=(env PYTHONPATH="$PWD" PYTHONUNBUFFERED=1 "$environment/bin/python")

# That everything compiles for CUDA is tested without a GPU.
tests=$(timeout $((time / 4)) "${run[@]}" -m pytest tests/engine/test_cuda.py -q -k "not compile" 2>&1 |
  tee "$out/gpu_tests.log" | tail -n 1) || tests="failed or cut off: $tests"
echo "Tests: $tests"

"${run[@]}" -m benchmarks.gpu --output "$out/gpu.json" --tests "$tests" --budget $((time - SECONDS)) "$@"
