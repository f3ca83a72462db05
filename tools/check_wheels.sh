#!/bin/sh
# Install ORBIT from a folder of wheels alone into a new environment outside of the checkout, and use it as one would: a
# task by its expert and by a kept policy, scenarios, and the contract tests of a plugin of one's own.
#   usage: check_wheels.sh WHEELS PLUGIN     (PLUGIN: folder of the plugin orbit-torch; PYTHON names the interpreter)
set -eu
wheels=$(realpath "$1")
plugin=$(realpath "$2")
constraints=$(realpath constraints.txt)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
env="$work/env"
"${PYTHON:-python3}" -m venv "$env"
cp -r "$plugin" "$work/plugin"
cd "$work"
"$env/bin/pip" install --quiet --find-links "$wheels" --constraint "$constraints" \
    "orbit-core[mujoco,tasks,robots,conformance]" ./plugin
"$env/bin/orbit" run Lift --backend mujoco --num-envs 4 --episodes 4
"$env/bin/orbit" play reach --backend mujoco --num-envs 4 --episodes 4
"$env/bin/orbit" conformance --quick --part scenarios --backend mujoco --scenario free_fall resting_weight \
    --output conformance
"$env/bin/pytest" -q -p no:cacheprovider --pyargs orbit_conformance --backend torch -k "rays or reset"
"$env/bin/pip" check
