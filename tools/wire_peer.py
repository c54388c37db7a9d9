"""What a peer of either side needs to speak the contract: generated messages, frames on a socket, and the position hash.

The messages are generated from protocol/coupling.proto into a temporary folder at start; a peer for production would keep them.
"""
import importlib
import pathlib
import struct
import subprocess
import sys
import tempfile
import zlib

_MASK = (1 << 64) - 1


def _generate():
    source = pathlib.Path(__file__).resolve().parent.parent / "protocol"
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["protoc", f"--proto_path={source}", f"--python_out={folder}", "coupling.proto"], check=True)
        sys.path.insert(0, folder)
        try:
            return importlib.import_module("coupling_pb2")
        finally:
            sys.path.remove(folder)


wire = _generate()

# In the order of the header's type number.
_TYPES = [wire.Hello, wire.InitialStress, wire.Balance, wire.ContinuumExcavated, wire.GrainsExcavated, wire.Velocities,
          wire.Forces, wire.Progress, wire.CheckpointRequest, wire.CheckpointCommit, wire.Finish, wire.Abort]
_HEADER = struct.Struct("<4sHHII")  # magic, header version, type, payload length, CRC-32
_MAX_PAYLOAD = 256 << 20


class Wire:
    """Whole messages over a connected socket. Every fault ends the program with a line in words."""

    def __init__(self, connection):
        self._socket = connection
        self._socket.settimeout(60)
        self._socket.setsockopt(6, 1, 1)  # IPPROTO_TCP, TCP_NODELAY: a frame leaves at once

    def send(self, message):
        payload = message.SerializeToString()
        header = _HEADER.pack(b"LKST", 1, _TYPES.index(type(message)), len(payload), zlib.crc32(payload))
        self._socket.sendall(header + payload)  # one write

    def expect(self, *kinds):
        """The next message, which must be one of `kinds`. Progress is skipped; the peer's Abort ends this side too."""
        while True:
            magic, version, number, size, checksum = _HEADER.unpack(self._read(_HEADER.size))
            if magic != b"LKST" or version != 1 or number >= len(_TYPES) or size > _MAX_PAYLOAD:
                self.abort(3, f"bad header: magic {magic}, version {version}, type {number}, {size} bytes")
            payload = self._read(size)
            if zlib.crc32(payload) != checksum:
                self.abort(3, f"damaged {_TYPES[number].__name__}")
            message = _TYPES[number].FromString(payload)
            if isinstance(message, wire.Abort):
                sys.exit(f"peer gave up: {message.reason}")
            if isinstance(message, kinds):
                if isinstance(message, wire.Hello) and message.major != 1:
                    self.abort(3, f"protocol versions differ: 1 and {message.major}")
                return message
            if not isinstance(message, wire.Progress):
                self.abort(3, f"{type(message).__name__} where {' or '.join(k.__name__ for k in kinds)} is due")

    def abort(self, exit_code, reason):
        self.send(wire.Abort(exit_code=exit_code, reason=reason))
        print(reason, file=sys.stderr)
        sys.exit(exit_code)

    def _read(self, size):
        parts = bytearray()
        while len(parts) < size:
            part = self._socket.recv(size - len(parts))
            if not part:
                sys.exit(f"the peer closed the connection: {len(parts)} of {size} bytes")
            parts += part
        return bytes(parts)


def hash_of(positions):
    """The hash of common/hash.hpp over all node positions in order."""
    state = 0xcbf29ce484222325
    for node in positions:
        for word in struct.unpack("<3Q", struct.pack("<3d", *node)):
            state = (((state ^ word) * 0x100000001b3) + (state >> 47)) & _MASK
    for factor in (0xff51afd7ed558ccd, 0xc4ceb9fe1a85ec53):
        state = ((state ^ (state >> 33)) * factor) & _MASK
    return state ^ (state >> 33)
