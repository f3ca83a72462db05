"""Agents: directed graphs of timed nodes between sensors and actuators, and the cut that makes one learnable."""

from orbit_core.agent.graph import AgentGraph, Concatenate, Cut, Edge, FunctionNode, GraphState

__all__ = ["AgentGraph", "Concatenate", "Cut", "Edge", "FunctionNode", "GraphState"]
