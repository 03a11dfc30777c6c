#!/usr/bin/env bash
# Builds the image of a node from Debian packages, without a registry:  deploy/image/build.sh [NAME]
# It has Debian, Chromium, its driver, and GIIRL with its packages in /opt/giirl. Needs root, mmdebstrap and buildah.
#   MIRROR=... another Debian mirror; PYTHON=... the Python 3.11 whose pip fetches the packages
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
suite=bookworm # its Python has the version that the fetched packages are for
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' pyproject.toml)
name=${1:-localhost/giirl:$version}
python=${PYTHON:-.venv/bin/python}
packages=ca-certificates,chromium,chromium-driver,chromium-sandbox,fonts-liberation,procps,python3-venv,tini

for program in mmdebstrap buildah; do
  if ! command -v "$program" >/dev/null; then
    echo "image: $program is missing, type: apt-get install mmdebstrap buildah crun" >&2; exit 1
  fi
done
if [ "$(id -u)" -ne 0 ]; then echo "image: wanted root, type: sudo make image" >&2; exit 1; fi
if ! "$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))'; then
  echo "image: $python is $("$python" --version), and Debian $suite has Python 3.11: wanted PYTHON=python3.11" >&2; exit 1
fi

export BUILDAH_FORMAT=docker # the other format has no health check
work=$(mktemp -d)
container=$(buildah from scratch)
trap 'buildah rm "$container" >/dev/null; rm -rf "$work"' EXIT
root=$(buildah mount "$container")

echo "image: installing Debian $suite"
mmdebstrap --quiet --variant=minbase --include="$packages" --dpkgopt='path-exclude=/usr/share/doc/*' \
  --dpkgopt='path-exclude=/usr/share/man/*' --dpkgopt='path-exclude=/usr/share/locale/*' \
  "$suite" "$root" ${MIRROR:+"$MIRROR"}

echo "image: fetching the packages of GIIRL $version"
"$python" -m pip wheel --quiet --disable-pip-version-check -c constraints.txt -w "$work" '.[train,cluster,report]'

echo "image: installing them"
install -d "$root/opt/giirl" "$root/wheels" "$root/runs"
cp "$work"/*.whl "$root/wheels/"
cp -r experiments "$root/opt/giirl/"
install -m 755 deploy/image/healthy "$root/usr/local/bin/giirl-healthy"
run() { buildah run --isolation=chroot "$container" -- "$@"; }
run python3 -m venv /opt/giirl/venv
run /opt/giirl/venv/bin/pip install --quiet --disable-pip-version-check --no-index --no-deps --find-links /wheels \
  $(cd "$work" && printf '/wheels/%s ' *.whl)
run useradd --uid 1000 --create-home giirl
run chown giirl:giirl /runs
rm -rf "$root/wheels" "$root"/var/cache/apt/archives/*.deb "$root"/var/lib/apt/lists/*

revision=$(git rev-parse --short HEAD 2>/dev/null || echo unknown)
buildah config --user 1000:1000 --workingdir /home/giirl \
  --env PATH=/opt/giirl/venv/bin:/usr/local/bin:/usr/bin:/bin --env GIIRL_REVISION="$revision" \
  --env RAY_USAGE_STATS_ENABLED=0 --env SE_OFFLINE=true --env SE_AVOID_STATS=true \
  --label org.opencontainers.image.version="$version" --label org.opencontainers.image.revision="$revision" \
  --port 9100 --volume /runs --entrypoint '["tini", "--"]' --cmd 'giirl --help' \
  --healthcheck 'CMD giirl-healthy' --healthcheck-interval 30s --healthcheck-start-period 60s "$container"
buildah commit --quiet "$container" "$name" >/dev/null
echo "image: $name"
