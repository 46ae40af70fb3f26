#!/usr/bin/env bash
# Sets up this checkout: a virtual environment .venv with Python 3.12 and the locked packages, and the system packages
# where apt and root are at hand. Quick when nothing is missing; may be interrupted and rerun at any time.
#
#   scripts/setup.sh                            # finds Python 3.12 by itself
#   PYTHON=/path/to/python3.12 scripts/setup.sh
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

readonly venv=.venv
readonly ready=$venv/.ready       # what the Makefile compares with the lock file
readonly partial=$venv/.partial   # there while packages are being installed

say() { printf 'setup: %s\n' "$*" >&2; }
stop() {
  say "$*"
  exit 1
}

# Prints the path of the interpreter behind a command, if it runs and is a Python 3.12 (a pyenv shim may do neither).
python_of() {
  "$1" -c 'import sys; print(sys._base_executable) if sys.version_info[:2] == (3, 12) else sys.exit(1)' 2>/dev/null
}

find_python() {
  local candidate
  if [[ -n ${PYTHON:-} ]]; then
    python_of "$PYTHON" || stop "PYTHON=$PYTHON is not a Python 3.12 that runs."
    return
  fi
  for candidate in python3.12 "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.12*/bin/python; do
    python_of "$candidate" && return
  done
  candidate=$(uv python find --no-python-downloads 3.12 2>/dev/null) && python_of "$candidate" && return
  stop "no Python 3.12 found. Install one ('pyenv install 3.12', 'uv python install 3.12' or your system's python3.12" \
    "with python3.12-venv), or name it: PYTHON=/path/to/python3.12 make setup"
}

# Rendering needs libEGL with a driver and libOpenGL; torchcodec needs the libraries that come with ffmpeg.
install_system_packages() {
  local package wanted=(libegl1 libgl1-mesa-dri libopengl0 ffmpeg) missing=()
  "$1" -c 'import ensurepip' 2>/dev/null || wanted+=(python3.12-venv)
  command -v dpkg-query >/dev/null || return 0 # not a Debian: the checks at the end tell what is missing
  for package in "${wanted[@]}"; do
    [[ $(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null) == installed ]] || missing+=("$package")
  done
  [[ ${#missing[@]} -gt 0 ]] || return 0
  if [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
    say "installing ${missing[*]}"
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
      "${missing[@]}"; } >/dev/null && return
  fi
  say "missing system packages; if rendering or video fails: sudo apt-get install ${missing[*]}"
}

# What tests alone need: a browser for pages, a display that nobody sees and a hand that types for keyboards. One by one,
# for not every system has all of these packages.
install_for_tests() { # PACKAGE PROGRAM...: installs the package unless one of the programs is there
  local package=$1 program
  for program in "${@:2}"; do
    command -v "$program" >/dev/null && return 0
  done
  if [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
    say "installing $package"
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
      "$package"; } >/dev/null && return
  fi
  say "no $package found, which some tests need: sudo apt-get install $package"
}

runs() { "$@" >/dev/null 2>&1; }

install_python_packages() {
  local python=$1 reinstall=()
  if ! { runs python_of $venv/bin/python && runs $venv/bin/uv --version; }; then
    say "creating $venv with $python"
    "$python" -m venv --clear $venv || stop "no virtual environment without venv: sudo apt-get install python3.12-venv"
    # The locked release, so that the following sync has no reason to replace it.
    $venv/bin/python -m pip install --quiet --disable-pip-version-check \
      "uv==$(sed -n '/^name = "uv"$/{n;s/version = "\(.*\)"/\1/p}' uv.lock)"
  elif [[ -e $partial ]]; then
    reinstall=(--reinstall) # an install that was cut off may have left a package that only looks whole
  fi
  : >$partial
  UV_PROJECT_ENVIRONMENT=$venv $venv/bin/uv sync --frozen --compile-bytecode --no-python-downloads \
    --python $venv/bin/python "${reinstall[@]}"
  rm $partial
}

check_rendering() {
  MUJOCO_GL=${MUJOCO_GL:-egl} $venv/bin/python -c '
import mujoco
with mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8) as renderer:
    renderer.render()' >/dev/null 2>$venv/render.log ||
    stop "MuJoCo cannot render here ($(grep -m 1 '^[A-Za-z.]*Error: ' $venv/render.log)); run:" \
      "sudo apt-get install libegl1 libgl1-mesa-dri libopengl0, then: make setup"
}

python=$(find_python)
install_system_packages "$python"
install_for_tests chromium chromium chromium-browser google-chrome
install_for_tests xvfb Xvfb
install_for_tests xdotool xdotool
install_python_packages "$python"
check_rendering
touch $ready
say "ready: Python packages are in $venv"
