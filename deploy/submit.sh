#!/usr/bin/env bash
# Submits one training run to a Ray cluster:  deploy/submit.sh CONFIG [key=value ...]
# RAY_ADDRESS names the cluster's dashboard, for example http://127.0.0.1:8265; RAY=.venv/bin/ray another client.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
if [ $# -eq 0 ]; then
  echo "submit: no config given, wanted: deploy/submit.sh CONFIG [key=value ...]" >&2
  exit 2
fi
if [ ! -f "$1" ]; then
  echo "submit: there is no config $1 in $PWD" >&2
  exit 2
fi
if [ -z "${RAY_ADDRESS:-}" ]; then
  echo "submit: RAY_ADDRESS is not set, wanted the dashboard: export RAY_ADDRESS=http://127.0.0.1:8265" >&2
  exit 2
fi
# No proxy stands between this machine and itself.
no_proxy=${no_proxy:-${NO_PROXY:-}}
export no_proxy="${no_proxy:+$no_proxy,}127.0.0.1,localhost,::1"
ray=${RAY:-.venv/bin/ray}
if ! answer=$("$ray" job list 2>&1); then
  echo "submit: no dashboard of Ray answers at RAY_ADDRESS=$RAY_ADDRESS: ${answer##*$'\n'}" >&2
  exit 1
fi
exec "$ray" job submit --working-dir . -- giirl train "$@" runtime=ray
