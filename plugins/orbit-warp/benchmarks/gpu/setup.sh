#!/usr/bin/env bash
# Makes the source tree runnable on a machine without a package registry: source this in the repository's root.
# Packages are expected unpacked in ~/site, parsed robots (a copy of ~/.cache/orbit) in .gpu/cache. A plugin whose engine
# is not among the packages is found and told to be broken, and the others go on.
site=${ORBIT_SITE:-$HOME/site}
mkdir -p "$site"
plugins="mjmodel warpkit warp matter mujoco bullet sapien"
export PYTHONPATH="$site:$PWD" PYTHONUNBUFFERED=1
for plugin in $plugins; do PYTHONPATH="$PYTHONPATH:$PWD/plugins/orbit-$plugin"; done
export ORBIT_CACHE_DIR="${ORBIT_CACHE_DIR:-$PWD/.gpu/cache}"

# Plugins, tasks and robots are found through the entry points of installed distributions.
python3 - "$site" $plugins <<'PYTHON'
import pathlib, sys, tomllib

for project in ("pyproject.toml", *(f"plugins/orbit-{plugin}/pyproject.toml" for plugin in sys.argv[2:])):
    data = tomllib.loads(pathlib.Path(project).read_text())["project"]
    name, version = data["name"].replace("-", "_"), data["version"]
    folder = pathlib.Path(sys.argv[1]) / f"{name}-{version}.dist-info"
    folder.mkdir(exist_ok=True)
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {data['name']}\nVersion: {version}\n")
    groups = data.get("entry-points", {})
    lines = [f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in names.items()) for group, names in groups.items()]
    (folder / "entry_points.txt").write_text("\n".join(lines))
PYTHON
