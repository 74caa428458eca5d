#!/usr/bin/env bash
# Makes the virtual environment of the benchmark of peers: rpod with all of its packages, small_gicp, and OpenCV's
# contrib build in place of the plain one. The two own the same files, so the plain one leaves first.
set -euo pipefail

venv=${1:-.venv-peers}
cd "$(dirname "$0")/.."
bash deploy/setup.sh "$venv"
pip=("$venv/bin/python" -m pip)
opencv=$("${pip[@]}" list --format freeze | sed -n 's/^opencv-python-headless==//p')
"${pip[@]}" install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[peers]'
if [[ -n $opencv ]]; then
  "${pip[@]}" uninstall --quiet --yes opencv-python-headless
  "${pip[@]}" install --quiet --disable-pip-version-check --force-reinstall --no-deps "opencv-contrib-python-headless==$opencv"
fi
echo "peers: ready"
