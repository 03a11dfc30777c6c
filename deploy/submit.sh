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
exec "${RAY:-.venv/bin/ray}" job submit --working-dir . -- giirl train "$@" runtime=ray
