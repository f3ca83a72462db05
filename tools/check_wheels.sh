#!/bin/sh
# Install ORBIT from a folder of wheels alone into a new environment outside of the checkout, and use it as one would.
#   usage: check_wheels.sh WHEELS WORK      (PYTHON names the interpreter)
set -eu
wheels=$(realpath "$1")
mkdir -p "$2"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
env="$work/env"
"${PYTHON:-python3}" -m venv "$env"
constraints=$(realpath constraints.txt)
cd "$work"
"$env/bin/pip" install --quiet --find-links "$wheels" --constraint "$constraints" \
    "orbit-core[mujoco,tasks,robots,conformance]"
"$env/bin/orbit" run Lift --backend mujoco --num-envs 4 --episodes 4
"$env/bin/orbit" run Lift --backend mujoco --num-envs 4 --episodes 4 --agent reach --help >/dev/null
"$env/bin/orbit" conformance --quick --part scenarios --backend mujoco --scenario free_fall resting_weight --output conformance
"$env/bin/pip" check
