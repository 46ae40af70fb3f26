#!/usr/bin/env bash
# Runs all tests with the newest release of a package in place of the locked one, in an environment of its own.
# Needs `make setup` or a Python 3.12. What this package refuses by its version is a failure, too: somebody has to look.
#
#   scripts/canary.sh lerobot      # or robosuite, or mujoco
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

package=${1:?which package: lerobot, robosuite or mujoco}
venv=${CANARY_VENV:-outputs/canary/$package}
case $package in
  lerobot) newest=(--upgrade-package lerobot 'lerobot[training]') ;;
  mujoco) newest=(--upgrade-package mujoco mujoco) ;;
  robosuite) newest=(--upgrade-package robosuite --no-deps robosuite) ;; # see docs/install.md
  *)
    printf 'canary: there is no %s to try\n' "$package" >&2
    exit 2
    ;;
esac

make --no-print-directory setup
UV_PROJECT_ENVIRONMENT=$venv .venv/bin/uv sync --frozen --no-python-downloads --python .venv/bin/python
.venv/bin/uv pip install --python "$venv/bin/python" "${newest[@]}"
.venv/bin/uv pip list --python "$venv/bin/python" | grep -E '^(lerobot|mujoco|robosuite|torch) '
"$venv/bin/python" -m pytest
