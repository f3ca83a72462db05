"""Runtime of an exported policy on NumPy and onnxruntime, without ORBIT: measured numbers in, joint targets out.

Written by ``orbit export POLICY --runtime FOLDER`` next to ``policy.onnx`` and ``runtime.json``, its numbers::

    policy = Runtime(Path(__file__).parent)
    while True:
        targets = policy.step(measured, positions)   # every 1 / policy.rate seconds

``policy.describe()`` lists what must be measured, with units, frames and the order of numbers.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnxruntime

FORMAT = 1
"""Version of ``runtime.json`` that this file reads."""
_LAST_ACTION = "last_action"

Array = npt.NDArray[np.float32]


class Runtime:
    """An exported policy of one robot.

    Args:
        folder: with ``policy.onnx`` and ``runtime.json``.

    Raises:
        ValueError: ``runtime.json`` is of another format.
    """

    def __init__(self, folder: str | Path) -> None:
        folder = Path(folder)
        self.document: dict[str, Any] = json.loads((folder / "runtime.json").read_text(encoding="utf-8"))
        """Content of ``runtime.json``."""
        if self.document["format"] != FORMAT:
            raise ValueError(f"runtime.json has format {self.document['format']}, and {FORMAT} is the one that is read")
        self._session = onnxruntime.InferenceSession(str(folder / "policy.onnx"))
        self.terms: dict[str, Any] = self.document["observations"]
        """Observation terms by name: shape, unit, scale, offset and meaning."""
        self.actions: list[dict[str, Any]] = self.document["actions"]
        """Action terms in order: joints, decoding and limits."""
        self.rate = 1.0 / self.document["step_dt"]
        """Hz at which :meth:`step` is called."""
        self.reset()

    def reset(self) -> None:
        """Begin an episode: the first observation counts as those before it, and nothing has been commanded yet."""
        self._past: dict[str, list[Array]] = {}
        self._action = np.zeros(sum(len(term["components"]) for term in self.actions), np.float32)
        self._asked: dict[str, Array] = {}

    def describe(self) -> str:
        """Return what must be measured, a line for each term, and what the action does."""
        lines = [
            f"{name}: {term['formula']} [{term['unit']}], {term['frame']}: {', '.join(term['components'])}"
            for name, term in self.terms.items()
        ]
        return "\n".join([*lines, *(f"action '{term['name']}': {term['decoding']}" for term in self.actions)])

    def step(
        self,
        measured: Mapping[str, Any],
        positions: Mapping[str, float],
        jacobians: Mapping[str, Any] | None = None,
    ) -> dict[str, float]:
        """Return position targets, rad or m, by joint.

        Args:
            measured: numbers of each term as sensors give them, in the order of its ``components``; the last action may
                be left out.
            positions: measured position of each joint, rad or m.
            jacobians: of each term of kind ``ik_relative`` by name: (6, k) of its frame and joints, linear rows, then
                angular, world axes.
        """
        self._action = self.act(measured)
        return self.targets(self._action, positions, jacobians)

    def observe(self, measured: Mapping[str, Any]) -> Array:
        """Return the observation (O,): scaled, offsets subtracted, with its history, the oldest step first."""
        parts: list[Array] = []
        for name, term in self.terms.items():
            # A group may name the term otherwise, so that it is known by its components.
            value = measured[name] if name in measured or not name.endswith(_LAST_ACTION) else self._action
            numbers = np.asarray(value, np.float32) - np.array(term["offset"], np.float32)
            scaled = np.float32(term["scale"]) * numbers
            past = self._past.setdefault(name, [scaled] * term["history"])
            self._past[name] = [*past[1:], scaled]
            parts += self._past[name]
        return np.concatenate(parts)

    def act(self, measured: Mapping[str, Any]) -> Array:
        """Return the action (A,) in [-1, 1]."""
        (action,) = self._session.run(["action"], {"observation": self.observe(measured)[None]})
        return np.clip(np.asarray(action, np.float32)[0], -1.0, 1.0)

    def targets(
        self, action: Array, positions: Mapping[str, float], jacobians: Mapping[str, Any] | None = None
    ) -> dict[str, float]:
        """Return the position targets of an action, as :meth:`step` does."""
        found: dict[str, float] = {}
        begin = 0
        for term in self.actions:
            command = action[begin : begin + len(term["components"])]
            begin += len(command)
            here = np.array([positions[joint] for joint in term["joints"]], np.float32)
            if term["kind"] == "joint_position":
                target = self._joint_position(term, command, here)
            elif term["kind"] == "binary_gripper":
                target = np.array(term["closed" if command[0] < 0.0 else "open"], np.float32)
            else:
                target = _ik_relative(term, command, here, np.asarray((jacobians or {})[term["name"]], np.float32))
            found |= dict(zip(term["joints"], target.tolist(), strict=True))
        return found

    def _joint_position(self, term: Mapping[str, Any], command: Array, here: Array) -> Array:
        if term["mode"] == "absolute":
            origin = np.array(term["home"], np.float32)
        else:
            origin = here if term["mode"] == "relative" else self._asked.get(term["name"], here)
        span = np.where(command < 0.0, np.array(term["below"], np.float32), np.array(term["above"], np.float32))
        target = origin + command * span
        if term["lead"] is not None:
            lead = _bounds(term["lead"], np.inf)
            target = np.clip(target, here - lead, here + lead)
        # Limits last: a lead must not carry a target beyond them.
        target = np.clip(target, _bounds(term["lower"], -np.inf), _bounds(term["upper"], np.inf)).astype(np.float32)
        self._asked[term["name"]] = target
        return target


def _ik_relative(term: Mapping[str, Any], command: Array, here: Array, jacobian: Array) -> Array:
    """Return one step of damped least squares towards a displaced hand, J^T (J J^T + lambda^2 I)^-1 e."""
    error = command * np.array([term["position_scale"]] * 3 + [term["rotation_scale"]] * 3, np.float32)
    square = jacobian @ jacobian.T + np.float32(term["damping"] ** 2) * np.eye(6, dtype=np.float32)
    delta = jacobian.T @ np.linalg.solve(square, error)
    # Shortened as a whole, so that the hand keeps its direction.
    delta *= min(1.0, term["max_joint_step"] / max(float(np.abs(delta).max()), 1e-12))
    return np.clip(here + delta, _bounds(term["lower"], -np.inf), _bounds(term["upper"], np.inf)).astype(np.float32)


def _bounds(values: list[float | None], infinite: float) -> Array:
    """Return limits as numbers; JSON has no infinity."""
    return np.array([infinite if value is None else value for value in values], np.float32)
