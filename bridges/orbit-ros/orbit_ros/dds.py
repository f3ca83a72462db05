"""ROS 2 by DDS: a participant that ROS 2 programs meet as a node's topics, without a ROS installation."""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import Callable
from typing import Any

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from orbit_core.interfaces import ConfigurationError
from orbit_ros.node import Message, RosNode, call_safely

LOOPBACK = ("127.0.0.1", "localhost")
MOST_DOMAINS = 232
"""Largest number of a domain: ports end there."""
# Fast DDS 3's type objects are rejected by Cyclone unless its vendor (1.15) is excepted; without a short SPDPInterval a
# peer that starts later is found after up to 8 s.
_COMMON = (
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>30</MaxAutoParticipantIndex>"
    "<SPDPInterval>500ms</SPDPInterval>{peers}</Discovery>"
    "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
)
_LOCAL = (
    '<General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General>"
)
_STREAM = (Policy.Durability.Volatile, Policy.History.KeepLast(10))
_RELIABLE = Policy.Reliability.Reliable(duration(milliseconds=100))
_LATCHED = (_RELIABLE, Policy.Durability.TransientLocal,
            Policy.History.KeepLast(1))  # fmt: skip


@functools.cache
def _domain(number: int, host: str) -> Domain:
    """Return the settings of a domain, which a process makes once."""
    local = host in LOOPBACK
    peer = "127.0.0.1" if local else host
    peers = f'<Peers><Peer address="{peer}"/></Peers>'
    body = (_LOCAL if local else "") + _COMMON.format(peers=peers)
    return Domain(number, f'<CycloneDDS><Domain id="any">{body}</Domain></CycloneDDS>')


class Ros2Node(RosNode):
    """Participant of one DDS domain.

    Args:
        domain: its number, ``ROS_DOMAIN_ID``.
        host: address of a peer; on this machine, no other machine is reached.
        prefix: of topics: ``rt/`` in ROS 2, and for Unitree's.

    Raises:
        ConfigurationError: the domain's number is none.
    """

    def __init__(self, domain: int = 0, host: str = "127.0.0.1", prefix: str = "rt/") -> None:
        if not 0 <= domain <= MOST_DOMAINS:
            raise ConfigurationError(f"a DDS domain is a number from 0 to {MOST_DOMAINS}, not {domain}: set the port")
        self._settings = _domain(domain, host)
        self._participant, self._prefix = DomainParticipant(domain), prefix
        self._waits = WaitSet(self._participant)
        self._readers: list[tuple[DataReader[Any], Callable[[Any, str], None]]] = []
        self._conditions: list[ReadCondition] = []
        self._writers: list[DataWriter[Any]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="ros2 node", daemon=True)
        self._lock = threading.Lock()
        self._thread.start()

    def advertise(self, topic: str, kind: type[Message], latched: bool = False) -> Callable[[Message], None]:
        qos = Qos(*_LATCHED) if latched else Qos(_RELIABLE, *_STREAM)
        writer = DataWriter(self._participant, Topic(self._participant, self._prefix + topic, kind), qos=qos)
        # A latched message is gone with its writer, even if the caller keeps the function.
        self._writers.append(writer)
        return writer.write

    def subscribe(
        self,
        topic: str,
        kind: type[Message],
        callback: Callable[[Message, str], None],
        latched: bool = False,
        large: bool = False,
    ) -> None:
        named = Topic(self._participant, self._prefix + topic, kind)
        # Readers that ask for no reliability match publishers of either kind, such as those of sensors.
        qos = Qos(*_LATCHED) if latched else Qos(Policy.Reliability.BestEffort, *_STREAM)
        if not large:
            self._read(DataReader(self._participant, named, qos=qos), callback)
            return
        # Of a picture's many packets one is lost often; a reader that asks for them again meets reliable publishers
        # only, so that there is one of each kind.
        again = DataReader(self._participant, named, qos=Qos(_RELIABLE, *_STREAM[:1], Policy.History.KeepLast(1)))
        self._read(again, callback)

        def take(message: Message, source: str) -> None:
            if not again.get_matched_publications():
                callback(message, source)

        self._read(DataReader(self._participant, named, qos=qos), take)

    def _read(self, reader: DataReader[Any], callback: Callable[[Any, str], None]) -> None:
        condition = ReadCondition(reader, SampleState.NotRead | ViewState.Any | InstanceState.Any)
        with self._lock:
            self._readers.append((reader, callback))
            self._conditions.append(condition)
            self._waits.attach(condition)

    def close(self) -> None:
        if self._ended.is_set():
            return
        self._ended.set()
        self._thread.join(2.0)
        # The participant frees what it made when nothing refers to it any more.
        self._readers, self._conditions, self._writers = [], [], []

    def _listen(self) -> None:
        sources: dict[tuple[int, DataReader[Any]], str] = {}
        while not self._ended.is_set():
            try:
                self._waits.wait(duration(milliseconds=20))
            except Exception:  # a wait set that is changed meanwhile
                logging.getLogger(__name__).debug("waiting for messages failed", exc_info=True)
            with self._lock:
                readers = list(self._readers)
            for reader, callback in readers:
                for sample in _taken(reader):
                    # A publisher that leaves yields a sample without data.
                    if isinstance(sample, IdlStruct):
                        handle: int = sample.sample_info.publication_handle  # pyright: ignore
                        if (handle, reader) not in sources:
                            sources[handle, reader] = _program(reader, handle)
                        call_safely(callback, sample, sources[handle, reader])


def _taken(reader: DataReader[Any]) -> list[Any]:
    """Return new samples; none where one has bytes that are no message of its type."""
    try:
        return reader.take(20)
    except Exception as error:
        # Whoever sent it, the next messages must be heard.
        logging.getLogger(__name__).warning("a message of %s could not be read: %s", reader.topic.name, error)
        return []


def _program(reader: DataReader[Any], handle: int) -> str:
    """Return the identity of the program that a publisher belongs to, which may publish several topics."""
    found = reader.get_matched_publication_data(handle)
    # A publisher that has left again is itself only.
    return str(found.participant_key) if found is not None else str(handle)
