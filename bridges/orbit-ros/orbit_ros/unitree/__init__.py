"""Unitree's low-level messages for Go2 and G1, as ``unitree_sdk2`` lays them out."""
