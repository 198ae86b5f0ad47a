"""Protobuf's encoding by hand, as far as messages of agents and actions need it."""

HEADER_OK = b"\x0a\x03\x08\xc8\x01"  # UnityMessageProto.header { status: 200 }


def varint(value: int) -> bytes:
    """A non-negative number as protobuf writes it."""
    result = bytearray()
    while value > 0x7F:
        result.append(value & 0x7F | 0x80)
        value >>= 7
    result.append(value)
    return bytes(result)


def length_delimited(number: int, payload: bytes) -> bytes:
    """Field ``number`` with a string, bytes, a message or packed numbers in it."""
    return varint(number << 3 | 2) + varint(len(payload)) + payload


class MessageWalker:
    """Walks through a message that is expected to have one form; ``failed`` if it has another.

    Args:
        data: The message's bytes.

    Attributes:
        offset: Where it has come to.
        failed: Whether something else stood there; what it returned since is meaningless.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.offset = 0
        self.failed = False

    def at(self, number: int) -> bool:
        """Whether a length-delimited field ``number`` (below 16) begins here."""
        return not self.failed and self._data.startswith(bytes((number << 3 | 2,)), self.offset)

    def expect(self, constant: bytes) -> None:
        """Passes over bytes that have to be these."""
        self.failed |= not self._data.startswith(constant, self.offset)
        self.offset += len(constant)

    def enter(self, number: int) -> int:
        """Passes over the tag and length of a length-delimited field; returns where the field ends."""
        if not self.at(number):
            self.failed = True
            return self.offset
        self.offset += 1
        length = self._varint()
        end = self.offset + length
        self.failed |= end > len(self._data)
        return end

    def enter_last(self, number: int) -> None:
        """Passes over the tag and length of a field that reaches to the message's end."""
        self.failed |= self.enter(number) != len(self._data)

    def take(self, number: int) -> bytes:
        """The content of a length-delimited field."""
        end = self.enter(number)
        content = self._data[self.offset : end]
        self.offset = end
        return content

    def _varint(self) -> int:
        value, shift = 0, 0
        while self.offset < len(self._data) and shift < 35:
            byte = self._data[self.offset]
            self.offset += 1
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
            shift += 7
        self.failed = True
        return value
