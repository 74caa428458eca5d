#!/usr/bin/env bash
# Makes a virtual environment with everything that rpod and its tests need.
# Needs Python 3.11 to 3.13. Repeating it changes nothing.
# A second argument, without-code or only-code, leaves out the numerical code, or makes nothing else.
set -euo pipefail

venv=${1:-.venv} part=${2:-all}
cd "$(dirname "$0")/.."

fail() { printf 'setup: %s\n' "$1" >&2; exit 1; }

compile() {
  echo "setup: the numerical code is compiled, once (about two minutes on two free cores, four on a loaded machine)"
  "$venv/bin/python" -m rpod compile
  echo "setup: ready"
}

if [[ $part == only-code ]]; then compile; exit; fi

# A Python that will do: the one named, or the newest that is installed.
python=${PYTHON:-}
if [[ -z $python ]]; then
  for candidate in python3 python3.13 python3.12 python3.11; do
    if command -v "$candidate" >/dev/null && "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null; then
      python=$candidate
      break
    fi
  done
fi
[[ -n $python ]] || fail "no Python 3.11 to 3.13 found; install one, or name it: make PYTHON=/path/to/python3.12"

if [[ ! -x $venv/bin/python ]]; then
  echo "setup: virtual environment in $venv ($("$python" --version))"
  # Debian ships venv without ensurepip; virtualenv carries its own pip.
  if ! "$python" -m venv "$venv" >/dev/null 2>&1; then
    rm -rf "$venv"
    bootstrap=$(mktemp -d)
    trap 'rm -rf "$bootstrap"' EXIT
    "$python" -m pip install --quiet --target "$bootstrap" virtualenv \
      || fail "neither venv nor pip works in $python; on Debian: apt-get install python3-venv"
    PYTHONPATH=$bootstrap "$python" -m virtualenv --quiet "$venv"
  fi
fi

echo "setup: dependencies, as pinned in constraints.txt (about 3 GB on the disk, and some minutes the first time)"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check "pip>=25.1"
wanted=(--constraint constraints.txt --editable '.[all]' --group dev --group docs --group devices)
# uv takes half of pip's time. Where it does not work (a mirror that only pip knows), pip does the same.
index=${PIP_INDEX_URL:-$("$venv/bin/python" -m pip config get global.index-url 2>/dev/null || true)}
if ! { "$venv/bin/python" -m pip install --quiet --disable-pip-version-check uv==0.13.9 \
  && "$venv/bin/uv" pip install --quiet --python "$venv/bin/python" --compile-bytecode ${index:+--default-index "$index"} "${wanted[@]}"; }; then
  echo "setup: uv did not install them; with pip it takes longer"
  "$venv/bin/python" -m pip install --quiet --disable-pip-version-check "${wanted[@]}"
fi

# Open3D's wheel links against system libraries that a bare machine lacks.
libraries=(libusb-1.0-0 libegl1 libgl1 libx11-6 libgomp1)
if ! problem=$("$venv/bin/python" -c 'import open3d' 2>&1); then
  install="apt-get update && apt-get install -y --no-install-recommends ${libraries[*]}"
  if [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
    echo "setup: system libraries of Open3D"
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${libraries[@]}" >/dev/null
    problem=$("$venv/bin/python" -c 'import open3d' 2>&1) || fail "Open3D still does not load: ${problem##*$'\n'}"
  else
    fail "Open3D lacks system libraries (${problem##*$'\n'}). Run, as root: $install"
  fi
fi

[[ $part == without-code ]] || compile
