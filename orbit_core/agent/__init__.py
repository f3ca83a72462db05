"""Agents: directed graphs of timed nodes between sensors and actuators, and the cut that makes one learnable."""

from orbit_core.agent.graph import AgentGraph, Cut, GraphState
from orbit_core.agent.wiring import Concatenate, Edge, FunctionNode

__all__ = ["AgentGraph", "Concatenate", "Cut", "Edge", "FunctionNode", "GraphState"]
