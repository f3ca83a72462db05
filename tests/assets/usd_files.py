"""USD files as other tools write them, for tests."""

from __future__ import annotations

from pathlib import Path

METRES = 'metersPerUnit = 1\n    upAxis = "Z"'
CENTIMETRES = 'metersPerUnit = 0.01\n    kilogramsPerUnit = 1\n    upAxis = "Y"'


def stage(folder: Path, content: str, header: str = METRES, name: str = "stage.usda") -> Path:
    """A file whose default prim ``/top`` holds ``content``."""
    path = folder / name
    path.write_text(f'#usda 1.0\n(\n    defaultPrim = "top"\n    {header}\n)\ndef Xform "top"\n{{\n{content}\n}}\n')
    return path


def body(name: str, inner: str = "", at: tuple[float, float, float] = (0.0, 0.0, 0.0), schemas: str = "") -> str:
    """A rigid body of one unit of mass and inertia."""
    return f"""
    def Xform "{name}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"{schemas}])
    {{
        float physics:mass = 1
        float3 physics:diagonalInertia = (1, 1, 1)
        double3 xformOp:translate = {at}
        uniform token[] xformOpOrder = ["xformOp:translate"]
        {inner}
    }}"""


def joint(kind: str, name: str, first: str | None, second: str, inner: str = "", schemas: str = "") -> str:
    """A joint between two bodies of ``/top``, or from the world where the first is ``None``."""
    parent = f"rel physics:body0 = </top/{first}>" if first else ""
    applied = f" (prepend apiSchemas = [{schemas}])" if schemas else ""
    return f"""
    def Physics{kind}Joint "{name}"{applied}
    {{
        {parent}
        rel physics:body1 = </top/{second}>
        {inner}
    }}"""


CUBE = 'def Cube "cube" (prepend apiSchemas = ["PhysicsCollisionAPI"])\n{\n    double size = 0.1\n}'
