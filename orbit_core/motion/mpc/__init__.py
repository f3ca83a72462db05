"""Model-predictive control of whole bodies by crocoddyl: hands on arms that drive, and trunks on legs."""

from orbit_core.motion.mpc.gait import Gait, stance_at
from orbit_core.motion.mpc.hand import HandMpc, HandMpcConfig
from orbit_core.motion.mpc.plan import Plan
from orbit_core.motion.mpc.predictive import Predictive, PredictiveConfig
from orbit_core.motion.mpc.trunk import TrunkMpc, TrunkMpcConfig

__all__ = [
    "Gait",
    "HandMpc",
    "HandMpcConfig",
    "Plan",
    "Predictive",
    "PredictiveConfig",
    "TrunkMpc",
    "TrunkMpcConfig",
    "stance_at",
]
