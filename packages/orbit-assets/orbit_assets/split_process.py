"""Process that splits one mesh by CoACD, so that a split can be stopped and a crash is isolated.

    python -P split_process.py FOLDER CONCAVITY MOST

Reads ``mesh.npz`` of the folder and writes ``pieces.npz`` there; says on its error stream why it could not.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np


def main(folder: Path, concavity: float, most: int) -> int:
    """Split the folder's mesh into at most ``most`` pieces, -1 for any number; return the exit code."""
    import coacd

    coacd.set_log_level("error")
    with np.load(folder / "mesh.npz", allow_pickle=False) as mesh:
        solid = coacd.Mesh(mesh["vertices"], mesh["faces"].astype(np.int32))
    try:
        found = coacd.run_coacd(solid, threshold=concavity, max_convex_hull=most)
    # Errors go to the caller as one line; a crash of the native library is seen by its exit code.
    except (RuntimeError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    arrays: dict[str, np.ndarray] = {}
    for number, (vertices, faces) in enumerate(found):
        arrays |= {f"vertices_{number}": np.asarray(vertices), f"faces_{number}": np.asarray(faces)}
    np.savez(folder / "pieces.npz", allow_pickle=False, **arrays)
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])))
