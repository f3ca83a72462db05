"""Run an exported policy with NumPy and onnxruntime alone: everything that the loop needs stands in the file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnxruntime

Array = npt.NDArray[np.float32]


class OnnxLoop:
    """An exported policy of one robot: measured numbers in, action and joint targets out.

    Args:
        file: ``policy.onnx`` of ``orbit export``.
    """

    def __init__(self, file: str | Path) -> None:
        self._session = onnxruntime.InferenceSession(str(file))
        document = json.loads(self._session.get_modelmeta().custom_metadata_map["orbit"])
        self.manifest: dict[str, Any] = document["manifest"]
        self.terms: dict[str, Any] = self.manifest["observations"][document["policy"]["group"]]["terms"]
        self.rate = 1.0 / self.manifest["step_dt"]
        self._past: dict[str, list[Array]] = {}

    def describe(self) -> str:
        """Return what must be measured, a line for each term, and what the action does."""
        lines = [
            f"{name}: {term['formula']} [{term['unit']}], {term['frame']}: {', '.join(term['components'])}"
            for name, term in self.terms.items()
        ]
        lines += [f"action '{name}': {term['decoding']}" for name, term in self.manifest["action_terms"].items()]
        return "\n".join(lines)

    def reset(self) -> None:
        """Begin an episode: the first observation stands for those before it."""
        self._past = {}

    def observe(self, measured: Mapping[str, Array]) -> Array:
        """Return the observation (O,).

        Args:
            measured: for each term its numbers as sensors give them, in the order of its ``components``: positions of
                joints are absolute, for the file holds the offset that is subtracted.
        """
        parts: list[Array] = []
        for name, term in self.terms.items():
            offset = np.array(term["offset"], np.float32)
            value = np.float32(term["scale"]) * (np.asarray(measured[name], np.float32) - offset)
            past = self._past.setdefault(name, [value] * term["history"])
            self._past[name] = [*past[1:], value]
            parts += self._past[name]  # the oldest first
        return np.concatenate(parts)

    def act(self, measured: Mapping[str, Array]) -> Array:
        """Return the action (A,) in [-1, 1]."""
        observation = self.observe(measured)[None]
        (action,) = self._session.run(["action"], {"observation": observation})
        return np.clip(np.asarray(action)[0], -1.0, 1.0)

    def joint_targets(self, action: Array, positions: Mapping[str, float]) -> dict[str, float]:
        """Return position targets, rad or m, by joint, where they are ``offset + scale * action``.

        Args:
            action: of :meth:`act`.
            positions: measured of each joint, absolute: targets may lead them by so much only.
        """
        targets: dict[str, float] = {}
        begin = 0
        for term in self.manifest["action_terms"].values():
            part = action[begin : begin + len(term["components"])]
            begin += len(part)
            if term["scale"] is None:
                continue
            for column, joint in enumerate(term["joints"]):
                target = term["offset"][column] + term["scale"][column] * part[column]
                if term["leads"] and term["leads"][column] is not None:
                    lead = term["leads"][column]
                    target = np.clip(target, positions[joint] - lead, positions[joint] + lead)
                low, high = term["lower_limits"][column], term["upper_limits"][column]
                target = target if low is None else max(target, low)
                targets[joint] = float(target if high is None else min(target, high))
        return targets
