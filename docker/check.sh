#!/usr/bin/env bash
# Builds both images from a clean clone of HEAD and holds them to what docs/docker.md says. Needs a Docker engine and
# docker-compose (or the Compose plugin); removes its containers and its clone, and leaves the images.
set -euo pipefail
repository=$(cd "$(dirname "$0")/.." && pwd)
clone=$(mktemp -d)
project=corridor-check-$$
if docker compose version >/dev/null 2>&1; then compose=(docker compose); else compose=(docker-compose); fi
c() { "${compose[@]}" -p "$project" -f "$clone/docker/compose.yaml" "$@"; }
unity() { c -f "$clone/docker/compose.unity.yaml" "$@"; }
trap 'c down --timeout 5 >/dev/null 2>&1 || true; rm -rf "$clone"' EXIT
fail() { echo "FAILED: $*" >&2; c logs --tail 40 >&2 || true; exit 1; }
ok() { echo "ok: $*"; }
container() { c ps -a -q "$1" 2>/dev/null || c ps -q "$1"; }
field() { docker inspect --format "$2" "$(container "$1")"; }
summary() { python3 -c "import json, sys; print(json.load(open(sys.argv[1]))[sys.argv[2]])" "$clone/results/$1/summary.json" "$2"; }
both_ended_well() {
  for service in trainer env; do
    [ "$(field $service '{{.State.Status}} {{.State.ExitCode}}')" = "exited 0" ] ||
      fail "$1: $service is $(field $service '{{.State.Status}}, code {{.State.ExitCode}}')"
  done
}
wait_for() { for _ in $(seq "$1"); do if "${@:2}"; then return 0; fi; sleep 1; done; return 1; }
ended() { [ "$(field "$1" '{{.State.Status}}')" = exited ]; }

git clone --quiet "$repository" "$clone"
export NUM_ENVS=2 TRAIN_ARGS="--num-areas 16 --eval-episodes 10"

c build >"$clone/build.log" 2>&1 || { tail -40 "$clone/build.log" >&2; fail "the images do not build"; }
base=$(docker image inspect --format '{{.Size}}' "${PYTHON_IMAGE:-python:3.11-slim}")
size=$(($(docker image inspect --format '{{.Size}}' curious-corridor-env) - base))
[ $size -lt 250000000 ] || fail "the env image is $((size / 1000000)) MB beyond its base"
ok "both images build; env is $((size / 1000000)) MB beyond its base"

RUN_ID=short STEPS=20000 c up >"$clone/up.log" 2>&1 || { tail -40 "$clone/up.log" >&2; fail "up"; }
both_ended_well "a short run"
[ "$(summary short env_steps)" -ge 20000 ] || fail "no summary of the short run"
for service in trainer env; do
  [ "$(field $service '{{.HostConfig.ReadonlyRootfs}} {{.Config.User}} {{len .HostConfig.PortBindings}}')" = "true ${USER_ID:-1000}:${USER_ID:-1000} 0" ] ||
    fail "$service: root file system, user or ports"
done
ok "a short run with two players ends, both containers with code 0, locked and not as root"

c run --rm trainer evaluate short --env builtin --episodes 5 >/dev/null || fail "run evaluate"
c run --rm trainer export short --onnx results/short.onnx >/dev/null || fail "run export"
[ -s "$clone/results/short.onnx" ] || fail "no ONNX file"
c down --timeout 5 >/dev/null 2>&1
ok "docker compose run passes any corridor command"

export STEPS=300000
RUN_ID=killed c up -d >/dev/null 2>&1 || fail "up"
wait_for 90 test -s "$clone/results/killed/checkpoints" -o -s "$clone/results/killed/progress.csv" || fail "no progress"
wait_for 30 sh -c "[ \$(wc -l <'$clone/results/killed/progress.csv') -gt 1 ]" || fail "no progress"
wait_for 30 sh -c "[ \"\$(docker inspect --format '{{.State.Health.Status}}' $(container trainer))\" = healthy ]" || fail "not healthy"
docker kill "$(container env)" >/dev/null
RUN_ID=killed c up -d env >/dev/null 2>&1
wait_for 300 ended trainer || fail "the run did not end"
wait_for 30 ended env || fail "env did not end"
both_ended_well "env killed in mid-run"
[ "$(summary killed restarts)" = 2 ] || fail "$(summary killed restarts) restarts of 2 players"
c down --timeout 5 >/dev/null 2>&1
ok "env killed in mid-run and started again: the run ends, both with code 0, its 2 restarts are in summary.json"

RUN_ID=ended TRAINER_PATIENCE=3 c up -d >/dev/null 2>&1 || fail "up"
wait_for 90 test -s "$clone/results/ended/progress.csv" || fail "no progress"
docker kill "$(container trainer)" >/dev/null
wait_for 60 ended env || fail "env goes on without a trainer"
c down --timeout 5 >/dev/null 2>&1
RUN_ID=alone TIMEOUT_WAIT=5 c up -d >/dev/null 2>&1 || fail "up"
wait_for 90 test -s "$clone/results/alone/progress.csv" || fail "no progress"
docker kill "$(container env)" >/dev/null
wait_for 60 ended trainer || fail "the trainer goes on without env"
[ "$(field trainer '{{.State.ExitCode}}')" = 1 ] || fail "the trainer's code without env"
c down --timeout 5 >/dev/null 2>&1
ok "the trainer's end ends env, and env's the trainer, whose run is kept"

export UNITY_FOLDER=$clone/tests/unity UNITY_BUILD=Build.x86_64
RUN_ID=unity STEPS=20000 unity up >"$clone/up.log" 2>&1 || { tail -40 "$clone/up.log" >&2; fail "up with a build"; }
both_ended_well "a build from a folder"
[ "$(summary unity env_steps)" -ge 20000 ] || fail "no summary of the build's run"
ok "a build from a mounted folder in env's place"
echo "docker: all checks passed"
