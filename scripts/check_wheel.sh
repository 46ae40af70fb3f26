#!/usr/bin/env bash
# Installs the built wheel with plain pip into a fresh environment, first without and then with the simulator, and checks
# that LeRobot's own commands know the policy and the environment. Neither way may compile anything or leave two OpenCVs.
# Needs `make setup`. Downloads about 3 GB where pip's cache is empty.
#
#   scripts/check_wheel.sh [FOLDER]     # FOLDER keeps the environment for a look afterwards
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

folder=${1:-$(mktemp -d)}
[[ -n ${1:-} ]] || trap 'rm -rf "$folder"' EXIT
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
base=$(.venv/bin/python -c 'import sys; print(sys._base_executable)')
bin=$folder/venv/bin

say() { printf '%s\n' "check_wheel: $*"; }
fail() {
  say "FAIL: $*" >&2
  exit 1
}

# A source build would need more than an installer; --only-binary turns one into an error.
install() { CC=false CXX=false "$bin/python" -m pip install --quiet --only-binary :all: "$@"; }

# Prints the help of a LeRobot command, run outside the checkout so that only the installed files can be found.
help_of() { (cd "$folder" && "$bin/$1" "${@:2}" --help 2>&1) || fail "'$* --help' stopped"; }

check_one_opencv() {
  local owners
  owners=$(cd "$folder" && "$bin/python" -c \
    'from importlib.metadata import packages_distributions as p; print(*sorted(set(p().get("cv2", ()))))')
  [[ $owners == opencv-python-headless ]] || fail "cv2 belongs to: ${owners:-nobody}"
}

check_commands() {
  local output
  output=$(help_of lerobot-train --policy.type=buds)
  grep -q 'BudsConfig' <<<"$output" || fail "lerobot-train does not describe policy 'buds'"
  output=$(help_of lerobot-train --policy.type=buds --env.type=robosuite)
  grep -q 'RobosuiteEnvConfig' <<<"$output" || fail "lerobot-train does not describe environment 'robosuite'"
  output=$(help_of lerobot-eval --policy.type=buds --env.type=robosuite)
  grep -q 'BudsConfig' <<<"$output" || fail "lerobot-eval does not describe policy 'buds'"
  grep -q 'RobosuiteEnvConfig' <<<"$output" || fail "lerobot-eval does not describe environment 'robosuite'"
  say "lerobot-train and lerobot-eval know policy 'buds' and environment 'robosuite'"
}

say "building the wheel in $folder"
.venv/bin/python -m hatchling build -t wheel -d "$folder" >/dev/null
wheel=$(ls "$folder"/lerobot_policy_buds-*.whl)
"$base" -m venv --clear "$folder/venv"

say "installing it without the simulator"
install "$wheel"
check_one_opencv
check_commands
(cd "$folder" && "$bin/lerobot-buds-doctor") || fail "the doctor objects"

say "installing the simulator"
install "$wheel[sim]"
install --no-deps robosuite==1.5.1
check_one_opencv
check_commands
(cd "$folder" && "$bin/lerobot-buds-doctor") || fail "the doctor objects"
(cd "$folder" && "$bin/python" -c '
import robosuite
env = robosuite.make("Lift", robots="Panda", has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False)
env.reset()
env.close()' 2>"$folder/lift.log") || fail "robosuite cannot reset Lift: $(tail -n 1 "$folder/lift.log")"
say "ok"
