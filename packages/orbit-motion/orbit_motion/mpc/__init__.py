"""Model-predictive control of whole bodies by crocoddyl: hands on arms with a mobile base, and trunks on legs."""

from orbit_motion.mpc.hand import HandMpc, HandMpcConfig
from orbit_motion.mpc.predictive import Plan, Predictive, PredictiveConfig
from orbit_motion.mpc.trunk import Gait, TrunkMpc, TrunkMpcConfig, stance_at

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
