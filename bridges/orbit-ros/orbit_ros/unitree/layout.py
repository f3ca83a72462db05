"""``LowCmd_`` and ``LowState_`` of Go2 (``unitree_go``) and G1 (``unitree_hg``) as NumPy records over their bytes.

Number by number, Python takes 400 to 900 us for a message, too dear at 500 Hz. All members are of fixed size, so
that a message is one record in C's layout, which the checksum needs too, and a permutation of bytes makes it CDR.
"""

import functools
from dataclasses import dataclass
from typing import Any, Self, get_args, get_type_hints

import numpy as np
import numpy.typing as npt
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import autoid, final
from cyclonedds.idl.types import array, float32, int16, int32, uint8, uint16, uint32

from orbit_core.interfaces import ConfigurationError
from orbit_ros.unitree.checksum import checksum

Record = npt.NDArray[Any]
SERVO = 1
"""Mode of a motor that follows its command."""
NO_POSITION, NO_VELOCITY = 2.146e9, 16000.0
"""Values of Go2's motors that follow no position, and no velocity."""
_CDR = {False: bytes((0, 1, 0, 0)), True: bytes((0, 7, 0, 0))}


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
            raise ConfigurationError(f"{len(data)} bytes are no {cls.__name__}, which has {len(places) + 4}")
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


@dataclass
@final
@autoid("sequential")
class GoMotorCmd(IdlStruct, typename="unitree_go.msg.dds_.MotorCmd_"):
    """Command of one motor: ``tau + kp (q - measured) + kd (dq - measured)``."""

    mode: uint8
    q: float32
    dq: float32
    tau: float32
    kp: float32
    kd: float32
    reserve: array[uint32, 3]


@dataclass
@final
@autoid("sequential")
class GoBmsCmd(IdlStruct, typename="unitree_go.msg.dds_.BmsCmd_"):
    """Command of the battery."""

    off: uint8
    reserve: array[uint8, 3]


@dataclass
@final
@autoid("sequential")
class GoLowCmd(Fixed, typename="unitree_go.msg.dds_.LowCmd_"):
    """Command of Go2's motors."""

    head: array[uint8, 2]
    level_flag: uint8
    frame_reserve: uint8
    sn: array[uint32, 2]
    version: array[uint32, 2]
    bandwidth: uint16
    motor_cmd: array[GoMotorCmd, 20]
    bms_cmd: GoBmsCmd
    wireless_remote: array[uint8, 40]
    led: array[uint8, 12]
    fan: array[uint8, 2]
    gpio: uint8
    reserve: uint32
    crc: uint32


@dataclass
@final
@autoid("sequential")
class GoImuState(IdlStruct, typename="unitree_go.msg.dds_.IMUState_"):
    """Orientation (w, x, y, z), rad/s, m/s^2, and roll, pitch and yaw."""

    quaternion: array[float32, 4]
    gyroscope: array[float32, 3]
    accelerometer: array[float32, 3]
    rpy: array[float32, 3]
    temperature: uint8


@dataclass
@final
@autoid("sequential")
class GoMotorState(IdlStruct, typename="unitree_go.msg.dds_.MotorState_"):
    """State of one motor."""

    mode: uint8
    q: float32
    dq: float32
    ddq: float32
    tau_est: float32
    q_raw: float32
    dq_raw: float32
    ddq_raw: float32
    temperature: uint8
    lost: uint32
    reserve: array[uint32, 2]


@dataclass
@final
@autoid("sequential")
class GoBmsState(IdlStruct, typename="unitree_go.msg.dds_.BmsState_"):
    """State of the battery."""

    version_high: uint8
    version_low: uint8
    status: uint8
    soc: uint8
    current: int32
    cycle: uint16
    bq_ntc: array[uint8, 2]
    mcu_ntc: array[uint8, 2]
    cell_vol: array[uint16, 15]


@dataclass
@final
@autoid("sequential")
class GoLowState(Fixed, typename="unitree_go.msg.dds_.LowState_"):
    """State of Go2."""

    head: array[uint8, 2]
    level_flag: uint8
    frame_reserve: uint8
    sn: array[uint32, 2]
    version: array[uint32, 2]
    bandwidth: uint16
    imu_state: GoImuState
    motor_state: array[GoMotorState, 20]
    bms_state: GoBmsState
    foot_force: array[int16, 4]
    foot_force_est: array[int16, 4]
    tick: uint32
    wireless_remote: array[uint8, 40]
    bit_flag: uint8
    adc_reel: float32
    temperature_ntc1: uint8
    temperature_ntc2: uint8
    power_v: float32
    power_a: float32
    fan_frequency: array[uint16, 4]
    reserve: uint32
    crc: uint32


@dataclass
@final
@autoid("sequential")
class HgMotorCmd(IdlStruct, typename="unitree_hg.msg.dds_.MotorCmd_"):
    """Command of one motor: ``tau + kp (q - measured) + kd (dq - measured)``."""

    mode: uint8
    q: float32
    dq: float32
    tau: float32
    kp: float32
    kd: float32
    reserve: uint32


@dataclass
@final
@autoid("sequential")
class HgLowCmd(Fixed, typename="unitree_hg.msg.dds_.LowCmd_"):
    """Command of G1's motors."""

    mode_pr: uint8
    mode_machine: uint8
    motor_cmd: array[HgMotorCmd, 35]
    reserve: array[uint32, 4]
    crc: uint32


@dataclass
@final
@autoid("sequential")
class HgImuState(IdlStruct, typename="unitree_hg.msg.dds_.IMUState_"):
    """Orientation (w, x, y, z), rad/s, m/s^2, and roll, pitch and yaw."""

    quaternion: array[float32, 4]
    gyroscope: array[float32, 3]
    accelerometer: array[float32, 3]
    rpy: array[float32, 3]
    temperature: int16


@dataclass
@final
@autoid("sequential")
class HgMotorState(IdlStruct, typename="unitree_hg.msg.dds_.MotorState_"):
    """State of one motor."""

    mode: uint8
    q: float32
    dq: float32
    ddq: float32
    tau_est: float32
    temperature: array[int16, 2]
    vol: float32
    sensor: array[uint32, 2]
    motorstate: uint32
    reserve: array[uint32, 4]


@dataclass
@final
@autoid("sequential")
class HgLowState(Fixed, typename="unitree_hg.msg.dds_.LowState_"):
    """State of G1."""

    version: array[uint32, 2]
    mode_pr: uint8
    mode_machine: uint8
    tick: uint32
    imu_state: HgImuState
    motor_state: array[HgMotorState, 35]
    wireless_remote: array[uint8, 40]
    reserve: array[uint32, 4]
    crc: uint32
