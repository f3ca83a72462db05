"""``LowCmd_`` and ``LowState_`` of Go2 (``unitree_go``) and G1 (``unitree_hg``) as NumPy records over their bytes.

Number by number, Python takes 400 to 900 us for a message, too dear at 500 Hz. All members are of fixed size, so
that a message is one record in C's layout, which the checksum needs too, and a permutation of bytes makes it CDR.
"""

import functools
import types
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self, TypeVar, get_args, get_type_hints

import numpy as np
import numpy.typing as npt
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import autoid, final
from cyclonedds.idl.types import array, float32, int16, int32, uint8, uint16, uint32

from orbit_core.interfaces import ConfigurationError

Record = npt.NDArray[Any]
SERVO = 1
"""Mode of a motor that follows its command."""
NO_POSITION, NO_VELOCITY = 2.146e9, 16000.0
"""Values of Go2's motors that follow no position, and no velocity."""
# Bits of each byte in the opposite order: zlib computes the reflected form of the same polynomial.
_REVERSED = np.array([int(f"{byte:08b}"[::-1], 2) for byte in range(256)], np.uint8)
_CDR = {False: bytes((0, 1, 0, 0)), True: bytes((0, 7, 0, 0))}


def checksum(data: npt.NDArray[np.uint8]) -> int:
    """Return Unitree's checksum of little-endian words: CRC-32, unreflected, without a final inversion.

    Args:
        data: (4 n,) bytes of the C layout without its last word.
    """
    # Words are taken in from their highest bit, so their bytes change places.
    words = _REVERSED[data.reshape(-1, 4)[:, ::-1]]
    reflected = zlib.crc32(words.tobytes()) ^ 0xFFFFFFFF
    return int(f"{reflected:032b}"[::-1], 2)


class Fixed(IdlStruct):
    """Message of members of fixed size. Its fields declare the layout only; values are in ``record``."""

    # No annotation, which would be a member.
    @property
    def record(self) -> Record:
        """Members (1,) in C's layout."""
        # Past the dataclass, which would count another member.
        return self.__dict__["values"]

    @classmethod
    def empty(cls) -> Self:
        """Return a message of zeros."""
        return cls.of(np.zeros(1, _layout(cls)))

    @classmethod
    def of(cls, record: Record) -> Self:
        """Return the message of a record (1,) in C's layout."""
        made = cls.__new__(cls)
        vars(made)["values"] = record
        return made

    def serialize(self, buffer: Any = None, endianness: Any = None, use_version_2: bool | None = None) -> bytes:
        """Return the message as CDR."""
        places, padding = _places(type(self))
        body = self.record.view(np.uint8)[places]
        # Zeros in padding make equal messages equal in bytes.
        body[padding] = 0
        return _CDR[bool(use_version_2)] + body.tobytes()

    @classmethod
    def deserialize(cls, data: bytes, has_header: bool = True, use_version_2: bool | None = None) -> Self:
        """Return the message of little-endian CDR.

        Raises:
            ConfigurationError: it is of another length, or big-endian.
        """
        places, padding = _places(cls)
        body = np.frombuffer(data, np.uint8, offset=4 if has_header else 0)[: len(places)]
        # The lowest bit of the encapsulation's second byte marks little-endian numbers.
        if len(body) < len(places) or (has_header and not data[1] & 1):
            package = cls.__idl_typename__.split(".")[0]
            raise ConfigurationError(
                f"{len(data)} bytes are no {cls.__name__} of {package}, which has {len(places) + 4}"
            )
        record = np.zeros(_layout(cls).itemsize, np.uint8)
        kept = ~padding
        record[places[kept]] = body[kept]
        return cls.of(record.view(_layout(cls)))

    def checksum(self) -> int:
        """Return the checksum of the present members."""
        # All but the checksum itself, which is the last member.
        return checksum(self.record.view(np.uint8)[:-4])

    def seal(self) -> Self:
        """Write the checksum, and return the message."""
        self.record["crc"] = self.checksum()
        return self

    @property
    def sealed(self) -> bool:
        """True if the checksum is right."""
        return int(self.record["crc"][0]) == self.checksum()


def _hint(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _members(kind: type) -> list[tuple[str, Any, int]]:
    """Return name, type and length (0 for a single one) of each member."""
    found = []
    for name in kind.__dataclass_fields__:  # pyright: ignore[reportAttributeAccessIssue]
        hint = _hint(kind)[name]
        mark = get_args(hint)[-1] if get_args(hint) else None
        length = getattr(mark, "length", 0)
        found.append((name, mark.subtype if length else hint, length))  # pyright: ignore[reportOptionalMemberAccess]
    return found


@functools.cache
def _layout(kind: type) -> np.dtype[Any]:
    """Return the record of a message in C's layout."""
    members = []
    for name, own, length in _members(kind):
        number = _layout(own) if isinstance(own, type) else np.dtype(get_args(own)[1])
        members.append((name, number, (length,)) if length else (name, number))
    # Aligned as C compilers lay out the vendor's structs, over whose bytes the checksum goes.
    return np.dtype(members, align=True)


@functools.cache
def _places(kind: type) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
    """Return the place in C's layout of each byte of the CDR, and which bytes of it are padding."""
    places: list[int] = []
    padding: list[bool] = []

    def add(layout: np.dtype[Any], offset: int) -> None:
        if layout.subdtype is not None:
            own, shape = layout.subdtype
            for index in range(shape[0]):
                add(own, offset + index * own.itemsize)
        elif layout.fields is not None:
            for name in layout.names or ():
                field, at, *_ = layout.fields[name]  # pyright: ignore[reportArgumentType]
                add(field, offset + at)
        else:
            # CDR aligns numbers to their size, and ends structs without padding.
            while len(places) % layout.itemsize:
                places.append(0)
                padding.append(True)
            places.extend(range(offset, offset + layout.itemsize))
            padding.extend([False] * layout.itemsize)

    add(_layout(kind), 0)
    return np.array(places), np.array(padding)


_Struct = TypeVar("_Struct", bound=IdlStruct)


def _struct(name: str, members: Mapping[str, Any], base: type[_Struct] = IdlStruct) -> type[_Struct]:
    """Return the type of a vendor's struct. Its members are flat: the robot's own type has no base to inherit from.

    Args:
        name: package and type, such as ``unitree_go LowCmd``.
        members: type of each member, in order.
        base: class that the type extends.
    """
    package, short = name.split()
    fields = {"__annotations__": dict(members), "__module__": __name__}
    kind = types.new_class(
        short, (base,), {"typename": f"{package}.msg.dds_.{short}_"}, lambda body: body.update(fields)
    )
    return autoid("sequential")(final(dataclass(kind)))


# The packages unitree_go (Go2) and unitree_hg (G1) share these parts, and differ in what follows them.
_TARGET = {"mode": uint8, "q": float32, "dq": float32, "tau": float32, "kp": float32, "kd": float32}
_MEASURED = {"mode": uint8, "q": float32, "dq": float32, "ddq": float32, "tau_est": float32}
# Orientation (w, x, y, z), rad/s, m/s^2, and roll, pitch and yaw
_INERTIAL = {
    "quaternion": array[float32, 4], "gyroscope": array[float32, 3], "accelerometer": array[float32, 3],
    "rpy": array[float32, 3],
}  # fmt: skip
_HEAD = {
    "head": array[uint8, 2], "level_flag": uint8, "frame_reserve": uint8, "sn": array[uint32, 2],
    "version": array[uint32, 2], "bandwidth": uint16,
}  # fmt: skip
_REMOTE = {"wireless_remote": array[uint8, 40]}
_CLOSE = {"reserve": uint32, "crc": uint32}

_GO_COMMAND = _struct("unitree_go MotorCmd", {**_TARGET, "reserve": array[uint32, 3]})
_GO_BATTERY_COMMAND = _struct("unitree_go BmsCmd", {"off": uint8, "reserve": array[uint8, 3]})
_GO_STATE = _struct(
    "unitree_go MotorState",
    {**_MEASURED, "q_raw": float32, "dq_raw": float32, "ddq_raw": float32, "temperature": uint8, "lost": uint32,
     "reserve": array[uint32, 2]},
)  # fmt: skip
_GO_BATTERY = _struct(
    "unitree_go BmsState",
    {"version_high": uint8, "version_low": uint8, "status": uint8, "soc": uint8, "current": int32, "cycle": uint16,
     "bq_ntc": array[uint8, 2], "mcu_ntc": array[uint8, 2], "cell_vol": array[uint16, 15]},
)  # fmt: skip
_GO_INERTIAL = _struct("unitree_go IMUState", {**_INERTIAL, "temperature": uint8})
_HG_COMMAND = _struct("unitree_hg MotorCmd", {**_TARGET, "reserve": uint32})
_HG_STATE = _struct(
    "unitree_hg MotorState",
    {**_MEASURED, "temperature": array[int16, 2], "vol": float32, "sensor": array[uint32, 2], "motorstate": uint32,
     "reserve": array[uint32, 4]},
)  # fmt: skip
_HG_INERTIAL = _struct("unitree_hg IMUState", {**_INERTIAL, "temperature": int16})
_HG_CLOSE = {"reserve": array[uint32, 4], "crc": uint32}

GoLowCmd = _struct(
    "unitree_go LowCmd",
    {**_HEAD, "motor_cmd": array[_GO_COMMAND, 20], "bms_cmd": _GO_BATTERY_COMMAND, **_REMOTE, "led": array[uint8, 12],
     "fan": array[uint8, 2], "gpio": uint8, **_CLOSE},
    Fixed,
)  # fmt: skip
"""Command of Go2's motors: each applies ``tau + kp (q - measured) + kd (dq - measured)``."""
GoLowState = _struct(
    "unitree_go LowState",
    {**_HEAD, "imu_state": _GO_INERTIAL, "motor_state": array[_GO_STATE, 20], "bms_state": _GO_BATTERY,
     "foot_force": array[int16, 4], "foot_force_est": array[int16, 4], "tick": uint32, **_REMOTE, "bit_flag": uint8,
     "adc_reel": float32, "temperature_ntc1": uint8, "temperature_ntc2": uint8, "power_v": float32,
     "power_a": float32, "fan_frequency": array[uint16, 4], **_CLOSE},
    Fixed,
)  # fmt: skip
"""State of Go2."""
HgLowCmd = _struct(
    "unitree_hg LowCmd",
    {"mode_pr": uint8, "mode_machine": uint8, "motor_cmd": array[_HG_COMMAND, 35], **_HG_CLOSE},
    Fixed,
)  # fmt: skip
"""Command of G1's motors, as those of Go2."""
HgLowState = _struct(
    "unitree_hg LowState",
    {"version": array[uint32, 2], "mode_pr": uint8, "mode_machine": uint8, "tick": uint32, "imu_state": _HG_INERTIAL,
     "motor_state": array[_HG_STATE, 35], **_REMOTE, **_HG_CLOSE},
    Fixed,
)  # fmt: skip
"""State of G1."""
