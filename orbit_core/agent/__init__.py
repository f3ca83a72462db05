"""Agents: directed graphs of timed nodes between sensors and actuators, and the cut that makes one learnable."""

from orbit_core.agent.cut import Cut
from orbit_core.agent.graph import AgentGraph, GraphState
from orbit_core.agent.nodes import Concatenate, FunctionNode
from orbit_core.agent.wiring import Edge

__all__ = ["AgentGraph", "Concatenate", "Cut", "Edge", "FunctionNode", "GraphState"]
