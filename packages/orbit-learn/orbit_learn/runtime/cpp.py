"""Header of C++ with the numbers of one exported policy, for ``orbit_runtime.hpp``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

_LAST_ACTION = "last_action"
# Fields of a term of runtime.json that hold numbers, in the order of ActionTerm; others keep their default
_JOINT_FIELDS = ("home", "above", "below", "lead", "open", "closed")
_IK_FIELDS = ("position_scale", "rotation_scale", "damping", "max_joint_step")


def cpp_header(document: Mapping[str, Any]) -> str:
    """Return the text of ``orbit_policy.hpp``.

    Args:
        document: content of ``runtime.json``.
    """
    lines = [
        f"// Numbers of a policy of task {document['task']}, written by `orbit export --runtime`.",
        "",
        "#pragma once",
        "",
        '#include "orbit_runtime.hpp"',
        "",
        "namespace orbit {",
        "",
        "/// Return the description of this policy.",
        "inline Description description() {",
        "  Description policy;",
        f"  policy.task = {_text(document['task'])};",
        f"  policy.robot = {_text(document['robot'] or '')};",
        f"  policy.step_dt = {document['step_dt']!r};",
    ]
    for name, term in document["observations"].items():
        lines += _block("ObservationTerm", "observations", _observation(name, term))
    for term in document["actions"]:
        lines += _block("ActionTerm", "actions", _action(term))
    return "\n".join([*lines, "  return policy;", "}", "", "}  // namespace orbit", ""])


def _block(kind: str, member: str, fields: Mapping[str, str]) -> list[str]:
    """Return the lines that append one term."""
    assigned = [f"    term.{name} = {value};" for name, value in fields.items()]
    return ["  {", f"    {kind} term;", *assigned, f"    policy.{member}.push_back(std::move(term));", "  }"]


def _observation(name: str, term: Mapping[str, Any]) -> dict[str, str]:
    return {
        "name": _text(name),
        **{key: _text(term[key]) for key in ("formula", "unit", "frame")},
        "components": _list(_text(each) for each in term["components"]),
        # One offset may hold for all numbers of a term.
        "offset": _floats(np.broadcast_to(np.array(term["offset"]), (len(term["components"]),)).tolist(), 0.0),
        "scale": _float(term["scale"]),
        "history": str(term["history"]),
        "last_action": str(name.endswith(_LAST_ACTION)).lower(),
    }


def _action(term: Mapping[str, Any]) -> dict[str, str]:
    fields = {
        "name": _text(term["name"]),
        "kind": f"ActionKind::{term['kind']}",
        "joints": _list(_text(joint) for joint in term["joints"]),
        "commands": str(len(term["components"])),
        "lower": _floats(term["lower"], -np.inf),
        "upper": _floats(term["upper"], np.inf),
    }
    if "mode" in term:
        fields["mode"] = f"CommandMode::{term['mode']}"
    fields |= {name: _floats(term[name], np.inf) for name in _JOINT_FIELDS if term.get(name) is not None}
    if "frame" in term:
        fields["frame"] = _text(term["frame"])
    return fields | {name: _float(term[name]) for name in _IK_FIELDS if name in term}


def _floats(values: Sequence[float | None], infinite: float) -> str:
    return _list(_float(infinite if value is None else value) for value in values)


def _float(value: float) -> str:
    """Return a literal that reads back as the same float32."""
    if np.isinf(value):
        return ("-" if value < 0 else "") + "std::numeric_limits<float>::infinity()"
    number = str(np.float32(value))
    return number + ("f" if "." in number or "e" in number else ".0f")


def _list(values: Any) -> str:
    return "{" + ", ".join(values) + "}"


def _text(value: str) -> str:
    # JSON's escapes of ASCII are those of C++; others become bytes of UTF-8, as \u in C++ excludes some characters.
    return json.dumps(value, ensure_ascii=False)
