"""Authored scenes: a document of what a person places, its file, its edits and the task made from it."""

from orbit_scenes.document.build import SceneBuilder
from orbit_scenes.document.files import load_document, save_document
from orbit_scenes.document.history import History
from orbit_scenes.document.model import Item, JointChange, SceneDocument, TaskPlan

__all__ = [
    "History", "Item", "JointChange", "SceneBuilder", "SceneDocument", "TaskPlan", "load_document", "save_document",
]  # fmt: skip
