#!/usr/bin/env bash
# Makes the source tree runnable on a machine without a package registry: source this in the repository's root.
# Packages are expected unpacked in ~/site, parsed robots (a copy of ~/.cache/orbit) in .gpu/cache. A plugin whose engine
# is not among the packages is found and told to be broken, and the others go on.
site=${ORBIT_SITE:-$HOME/site}
mkdir -p "$site"
plugins="mjmodel warpkit warp matter mujoco bullet sapien"
packages="assets motion learn data viewer policies deploy scenes"
export PYTHONPATH="$site:$PWD:$PWD/tests/conformance" PYTHONUNBUFFERED=1
for package in $packages; do PYTHONPATH="$PYTHONPATH:$PWD/packages/orbit-$package"; done
for plugin in $plugins; do PYTHONPATH="$PYTHONPATH:$PWD/plugins/orbit-$plugin"; done
export ORBIT_CACHE_DIR="${ORBIT_CACHE_DIR:-$PWD/.gpu/cache}"

# Plugins, tasks and robots are found through the entry points of installed distributions.
python3 - "$site" $plugins <<'PYTHON'
import pathlib, sys, tomllib

plugins = [pathlib.Path("plugins") / f"orbit-{plugin}" for plugin in sys.argv[2:]]
own = [pathlib.Path(), *pathlib.Path("packages").iterdir(), pathlib.Path("orbit_tasks"), pathlib.Path("tests/conformance")]
for folder in (*own, *plugins):
    project = folder / "pyproject.toml"
    data = tomllib.loads(project.read_text())["project"]
    name, version = data["name"].replace("-", "_"), data["version"]
    folder = pathlib.Path(sys.argv[1]) / f"{name}-{version}.dist-info"
    folder.mkdir(exist_ok=True)
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {data['name']}\nVersion: {version}\n")
    groups = data.get("entry-points", {})
    lines = [f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in names.items()) for group, names in groups.items()]
    (folder / "entry_points.txt").write_text("\n".join(lines))
PYTHON
