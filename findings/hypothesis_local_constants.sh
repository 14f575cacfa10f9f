#!/usr/bin/env bash
# hypothesis 6.170.15: with derandomize=True a test tries other examples after a constant was added to another module that the tests import.
# Source: a new module held 1e-9, and a test of an older one failed on a move of 1e-9 rad, run on 2026-12-01. Remedy: keep what was found as an @example.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3.11 -m venv "$dir/venv"
"$dir/venv/bin/pip" install -qq --disable-pip-version-check hypothesis==6.170.15 || { echo "the package could not be installed" >&2; exit 2; }

cat > "$dir/run.py" <<'PY'
import hypothesis
import settings_of_the_arm  # has nothing to do with what is tested
from hypothesis import given, settings
from hypothesis import strategies as st

tried = []


@settings(max_examples=200, derandomize=True, database=None)
@given(st.lists(st.floats(-2.5, 2.5), min_size=6, max_size=6))
def check(values):
    tried.extend(values)


check()
print(f"{hypothesis.__version__} {len(tried)} {tried.count(1.2345e-9)} {hash(tuple(tried))}")
PY

run() { (cd "$dir" && "$dir/venv/bin/python" run.py); }
echo 'LEAST_SPEED = 0.5' > "$dir/settings_of_the_arm.py"
first=$(run)
again=$(run)
printf 'LEAST_SPEED = 0.5\nTOLERANCE = 1.2345e-9\n' > "$dir/settings_of_the_arm.py"
changed=$(run)

echo "expected  the same 200 examples as long as neither the test nor hypothesis changes, since derandomize=True"
echo "seen      (version, values tried, of them 1.2345e-9, hash of all)"
echo "          one constant in the other module   $first"
echo "          once more                          $again"
echo "          with 1.2345e-9 in it               $changed"
[ "$first" = "$again" ] && [ "$first" != "$changed" ] \
    && [ "$(echo "$first" | cut -d' ' -f3)" = 0 ] && [ "$(echo "$changed" | cut -d' ' -f3)" -gt 0 ] \
    || { echo "this has changed" >&2; exit 1; }
