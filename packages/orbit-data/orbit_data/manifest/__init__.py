"""Manifests: the interface between an agent and a robot, as data that a program without ORBIT can follow."""
