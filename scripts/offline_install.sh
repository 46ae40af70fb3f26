#!/usr/bin/env bash
# Installs the bundle that this lies in into a folder, without any network, and checks what came out. May be interrupted
# and run again at any time; what experiments wrote into the folder stays.
#
#   ./install.sh FOLDER                                # finds Python 3.12 by itself
#   PYTHON=/path/to/python ./install.sh FOLDER         # the one that has torch
set -euo pipefail

say() { printf 'install: %s\n' "$*" >&2; }
stop() {
  say "$*"
  exit 1
}

[[ $# == 1 ]] || stop "usage: [PYTHON=/path/to/python] ./install.sh FOLDER"
bundle=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
mkdir -p "$1"
folder=$(cd "$1" && pwd)
venv=$folder/venv

is_python() { "$1" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 12))' 2>/dev/null; }
has() { "$python" -c 'import sys; from importlib.util import find_spec; sys.exit(not find_spec(sys.argv[1]))' "$1"; }
torch_of() { "$python" -c 'from importlib.metadata import version; print(version("torch").partition("+")[0])'; }

find_python() {
  local candidate
  for candidate in ${PYTHON:-python3 python3.12 python}; do
    is_python "$candidate" && python=$candidate && return
  done
  stop "no Python 3.12 found; name it: PYTHON=/path/to/python ./install.sh FOLDER"
}

unpack() {
  (cd "$bundle" && sha256sum --check --quiet SHA256SUMS) || stop "the bundle is damaged or not whole: carry it again"
  rm -rf "$folder/wheels"
  cat "$bundle"/part.* | tar -x --no-same-owner -C "$folder"
  cp "$bundle/bundle.json" "$folder"
}

# Prints the requirements. torchvision and torchcodec work with one version of torch alone: the node's own come first,
# the bundle's serve where its torch is the node's. LeRobot decodes video by other means where torchcodec is missing.
requirements() {
  local name line locked
  cat "$folder/requirements.txt"
  locked=$(sed -n 's/^torch==//p' "$folder/companions.txt")
  [[ -n $locked ]] || return 0 # torch is in the bundle
  has torch || stop "$python has no torch; name another (PYTHON=...), or make the bundle with --with_torch=true"
  for name in torchvision torchcodec; do
    line=$(grep "^$name==" "$folder/companions.txt" || true)
    if has $name || [[ -z $line ]]; then
      continue
    elif [[ $(torch_of) == "$locked" ]]; then
      printf '%s\n' "$line"
    elif [[ $name == torchvision ]]; then
      stop "$python has torch $(torch_of) without torchvision, and the bundle's works with torch $locked alone:" \
        "install torchvision there, or make the bundle with --with_torch=true"
    fi
  done
}

# Packages of the node are seen where the bundle has no other version of them. A virtual environment does not pass on
# its own packages, so where the node's Python is one they are named.
make_environment() {
  "$python" -m venv --clear --system-site-packages "$venv" || stop "no venv: on Debian, python3.12-venv is missing"
  "$python" -c 'import site, sys; print(*site.getsitepackages(), sep="\n") if sys.prefix != sys.base_prefix else None' \
    >"$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/node.pth"
}

install_wheels() {
  # Nothing that is set on the node may lead pip elsewhere, or to other versions.
  PIP_CONFIG_FILE=/dev/null "$venv/bin/python" -m pip --isolated --disable-pip-version-check install --quiet \
    --no-index --no-deps --find-links "$folder/wheels" --requirement "$folder/chosen.txt"
  rm -r "$folder/wheels"
}

find_python
say "checking and joining the parts"
unpack
requirements >"$folder/chosen.txt"
say "installing $(wc -l <"$folder/chosen.txt") packages into $venv beside those of $python"
make_environment
install_wheels
say "checking the installation"
(cd "$folder/project" && "$venv/bin/python" scripts/offline_check.py "$folder/chosen.txt") ||
  stop "installed, but something will not work: see above"
say "ready: cd $folder/project && ../venv/bin/python scripts/reproduce.py --dry_run=true"
