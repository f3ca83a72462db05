"""Active models: force laws that objects have of their own, computed before each physics step for all environments.

A law is data in a scene (:class:`orbit_core.scene.ActiveModel`) and a class here that computes it. A package adds its
own through the entry-point group ``orbit.active``, named as the data's class, with the law's class as value::

    [project.entry-points."orbit.active"]
    GasSpring = "my_package.gas_spring:GasSpringLaw"
"""

from orbit_core.active.laws import ActiveLaw, MagneticSealLaw, active_laws, create_law

__all__ = ["ActiveLaw", "MagneticSealLaw", "active_laws", "create_law"]
