#!/usr/bin/env bash
# Ray 2.58.0: its workers run at nice 15, the driver at 0. A task gets a few per cent of a core that any ordinary process uses, while `num_cpus=1` reserves that core for it.
# Source: found by experiment, run on 2026-11-30. Remedy: RAY_worker_niceness=0 before `ray start`, or ray.init(_system_config={"worker_niceness": 0}) for a local cluster.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3.11 -m venv "$dir/venv"
"$dir/venv/bin/pip" install -qq --disable-pip-version-check ray==2.58.0 || { echo "the packages could not be installed" >&2; exit 2; }

cat > "$dir/run.py" <<'PY'
import os
import subprocess
import sys
import time

os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
import ray

CORE = min(os.sched_getaffinity(0))
BUSY = f"import os; os.sched_setaffinity(0, {{{CORE}}})\nwhile True: pass"


@ray.remote(num_cpus=1)
def compute(core: int) -> tuple[int, float]:
    """Return the priority, and the share of the core that a computation of 4 s got."""
    os.sched_setaffinity(0, {core})
    start, used = time.monotonic(), time.process_time()
    while time.monotonic() - start < 4:
        pass
    return os.nice(0), (time.process_time() - used) / (time.monotonic() - start)


def shares(**settings) -> tuple[int, float, float]:
    """Return the priority of a task, and its share of a core, alone and beside an ordinary process on the same core."""
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False, logging_level="ERROR", **settings)
    nice, alone = ray.get(compute.remote(CORE))
    busy = subprocess.Popen([sys.executable, "-c", BUSY])
    try:
        _, beside = ray.get(compute.remote(CORE))
    finally:
        busy.kill()
        ray.shutdown()
    return nice, alone, beside


nice, alone, beside = shares()
fair_nice, _, fair = shares(_system_config={"worker_niceness": 0})
print(f"Ray {ray.__version__}; first seen 2026-11-30")
print("one would expect: a task that reserves a core shares it evenly with one other process: about 50 %")
print(f"what happens:     nice {nice}: alone {100 * alone:.0f} % of the core, beside another process {100 * beside:.0f} %")
print(f"                  nice {fair_nice} (worker_niceness=0): beside another process {100 * fair:.0f} %")
assert os.nice(0) == 0, "run it at the usual priority"
assert nice == 15 and beside < 0.2, "the behaviour changed"
assert fair_nice == 0 and fair > 2 * beside, "the remedy should work"
PY
"$dir/venv/bin/python" "$dir/run.py" 2> "$dir/log" || { cat "$dir/log" >&2; exit 1; }
