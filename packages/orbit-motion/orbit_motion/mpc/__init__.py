"""Model-predictive control of whole bodies by crocoddyl: hands on arms that drive, and trunks on legs."""

from orbit_motion.mpc.gait import Gait, stance_at
from orbit_motion.mpc.hand import HandMpc, HandMpcConfig
from orbit_motion.mpc.plan import Plan
from orbit_motion.mpc.predictive import Predictive, PredictiveConfig
from orbit_motion.mpc.trunk import TrunkMpc, TrunkMpcConfig

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
