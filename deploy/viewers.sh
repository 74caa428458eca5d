#!/usr/bin/env bash
# Gets what `make check-viewers` needs beside the tests' own packages: Rerun, packages of Node.js, and Debian's
# chromium and mesa-vulkan-drivers. What this machine does not give is named, and its checks are left out.
set -euo pipefail

venv=${1:-.venv}
cd "$(dirname "$0")/.."
packages=tests/viewers

lacking() { printf 'viewers: %s is missing here, and the checks that need it are left out: %s\n' "$1" "$2"; }

quietly() { timeout 240 "$@" >/dev/null 2>&1; }

as_root() { if [[ $(id -u) == 0 ]]; then quietly "$@"; else quietly sudo --non-interactive "$@"; fi; }

if ! quietly "$venv/bin/python" -c 'import rerun'; then
  echo "viewers: Rerun, as pinned in constraints.txt (about 250 MB)"
  quietly "$venv/bin/python" -m pip install --constraint constraints.txt rerun-sdk \
    || lacking rerun-sdk "pip cannot install it"
fi

updated=
install_debian() {
  echo "viewers: Debian's $1"
  [[ $updated ]] || as_root apt-get update || true  # an old list of packages may do
  updated=yes
  as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "$1" \
    || lacking "$1" "as root, try: apt-get install $1"
}

command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null \
  || install_debian chromium
compgen -G '/usr/share/vulkan/icd.d/lvp_icd*.json' >/dev/null || install_debian mesa-vulkan-drivers
command -v node >/dev/null && command -v npm >/dev/null || { install_debian nodejs; install_debian npm; }

if command -v npm >/dev/null && ! cmp -s "$packages/package-lock.json" "$packages/node_modules/.installed"; then
  echo "viewers: packages of Node.js, as pinned in $packages/package-lock.json"
  if said=$(timeout 240 npm ci --prefix "$packages" --ignore-scripts --no-audit --no-fund 2>&1); then
    cp "$packages/package-lock.json" "$packages/node_modules/.installed"
  else
    lacking "a set of packages of Node.js" "$(grep --max-count=1 'npm error' <<<"$said" || echo 'npm takes too long')"
  fi
fi
