#!/usr/bin/env bash
# Submits a training run to a Ray cluster:  deploy/submit.sh CONFIG [key=value ...]  or  deploy/submit.sh --resume RUN
# RAY_API_SERVER_ADDRESS names the cluster's dashboard, for example http://127.0.0.1:8265; RAY=.venv/bin/ray a client.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
dashboard=${RAY_API_SERVER_ADDRESS:-${RAY_ADDRESS:-}}
if [ $# -eq 0 ]; then
  echo "submit: no config given, wanted: deploy/submit.sh CONFIG [key=value ...], or deploy/submit.sh --resume RUN" >&2
  exit 2
fi
if [ "$1" = --resume ]; then
  if [ $# -lt 2 ]; then
    echo "submit: --resume without a run, wanted: deploy/submit.sh --resume RUN" >&2
    exit 2
  fi
  runtime=() # the run has it in its settings
else
  if [ ! -f "$1" ]; then
    echo "submit: there is no config $1 in $PWD" >&2
    exit 2
  fi
  runtime=(runtime=ray)
fi
if [ -z "$dashboard" ]; then
  echo "submit: wanted the dashboard: export RAY_API_SERVER_ADDRESS=http://127.0.0.1:8265" >&2
  exit 2
fi
# No proxy stands between this machine and itself.
no_proxy=${no_proxy:-${NO_PROXY:-}}
export no_proxy="${no_proxy:+$no_proxy,}127.0.0.1,localhost,::1"
ray=${RAY:-.venv/bin/ray}
if ! answer=$("$ray" job list --address "$dashboard" 2>&1); then
  echo "submit: no dashboard of Ray answers at $dashboard: ${answer##*$'\n'}" >&2
  exit 1
fi
exec "$ray" job submit --address "$dashboard" --working-dir . -- giirl train "$@" "${runtime[@]}"
