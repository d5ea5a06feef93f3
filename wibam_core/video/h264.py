"""What the packets of H.264 say of themselves (ITU-T H.264, 7.3 and 7.4): which are second fields, and what was lost.

An interlaced picture may come as two packets, one for each field, of which a decoder makes one frame. And pictures that
others are predicted from are counted: where the count jumps, some were lost, and what is decoded from there to the next
whole picture is smeared. No decoder tells so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

#: Slices in partitions (2 to 4, of the Extended profile alone) are none here: FFmpeg decodes no picture of them.
_SLICE, _IDR, _SPS = 1, 5, 7
_START = b"\x00\x00\x01"
#: Profiles whose parameter sets tell the format of colour, too (7.3.2.1.1).
_WITH_COLOUR = (100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135)
#: A slice's header up to where its field is told fits into so many bytes.
_HEADER_BYTES = 24
#: A parameter set, up to the last of what is read of it, fits into so many, whatever it says.
_UNIT_BYTES = 4096
_LONGEST_CODE = 32


class _NoHeader(ValueError):
    """Bytes that are no header as the standard has it."""


@dataclass(frozen=True)
class _Parameters:
    """What of a sequence parameter set is needed to read slices.

    Attributes:
        frame_num_bits: how many bits the count of reference pictures has.
        frames_only: no picture consists of two fields.
        separate_planes: slices say which colour they are of.
        gaps_allowed: counts may be left out on purpose.
    """

    frame_num_bits: int
    frames_only: bool
    separate_planes: bool
    gaps_allowed: bool


@dataclass(frozen=True)
class _Slice:
    """The first slice of a packet.

    Attributes:
        frame_num: how many pictures that others are predicted from came before, modulo a power of two.
        is_reference: others are predicted from it.
        is_idr: it is whole by itself, and so is all after it.
        field: 1 or 2 of a single field, 0 of a whole frame.
    """

    frame_num: int
    is_reference: bool
    is_idr: bool
    field: int


class H264Packets:
    """Looks at the packets of one stream, in the order of decoding.

    Args:
        extradata: what the container says before the first packet: parameter sets behind start codes, or the record
            of MP4 and Matroska (ISO/IEC 14496-15, 5.3.3.1), which also says that packets have lengths instead.
    """

    def __init__(self, extradata: bytes) -> None:
        self._length_bytes = (extradata[4] & 3) + 1 if extradata[:1] == b"\x01" and len(extradata) > 6 else 0
        self._parameters: _Parameters | None = None
        for unit in _of_record(extradata) if self._length_bytes else _by_start_codes(extradata):
            self._learn(unit)
        self._before: _Slice | None = None
        self._reference_num: int | None = None
        self._is_smeared = self._is_second_field = False
        self._is_picture = True

    def read(self, packet: bytes, *, is_key: bool) -> None:
        """Look at the next packet; what is found is in the properties. One that cannot be read changes nothing.

        Args:
            packet: all of it: what a camera tells beside a picture lies before its first slice, and may be long.
            is_key: the container says that it is whole by itself.
        """
        self._is_second_field = False
        self._is_picture = True
        try:
            found = self._first_slice(packet)
        except _NoHeader:
            return
        if self._parameters is None:
            return
        if found is None:
            self._is_picture = False
            return
        before, self._before = self._before, found
        opposite = before is not None and found.field and before.field == 3 - found.field
        if before is not None and opposite and found.frame_num == before.frame_num and not found.is_idr:
            self._is_second_field, self._before = True, None
            return
        self._follow(found, is_key or found.is_idr, self._parameters)

    @property
    def is_picture(self) -> bool:
        """Whether there is a slice in the packet that was read last; parameter sets alone are no picture."""
        return self._is_picture

    @property
    def is_second_field(self) -> bool:
        """Whether the packet that was read last completes the frame that the one before began."""
        return self._is_second_field

    @property
    def is_smeared(self) -> bool:
        """Whether pictures were lost since the last one that is whole by itself."""
        return self._is_smeared

    def _follow(self, found: _Slice, is_key: bool, parameters: _Parameters) -> None:
        if is_key:
            self._is_smeared = False
        elif self._reference_num is not None and not parameters.gaps_allowed:
            due = (self._reference_num, (self._reference_num + 1) % (1 << parameters.frame_num_bits))
            self._is_smeared |= found.frame_num not in due
        if is_key or (found.is_reference and self._reference_num is not None):
            self._reference_num = found.frame_num

    def _first_slice(self, packet: bytes) -> _Slice | None:
        units = _by_lengths(packet, self._length_bytes) if self._length_bytes else _by_start_codes(packet)
        for unit in units:
            kind = unit[0] & 31
            if kind == _SPS:
                self._learn(unit)
            elif kind in (_SLICE, _IDR):
                return None if self._parameters is None else _slice_of(unit, self._parameters)
        return None

    def _learn(self, unit: bytes) -> None:
        if unit and unit[0] & 31 == _SPS:
            try:
                self._parameters = _parameters_of(unit)
            except _NoHeader:
                self._parameters = None


class _Bits:
    """Reads bits (7.2), without the bytes that keep start codes from appearing by chance (7.4.1)."""

    def __init__(self, unit: bytes) -> None:
        content = unit[1:].replace(b"\x00\x00\x03", b"\x00\x00")
        self._left = 8 * len(content)
        self._value = int.from_bytes(content, "big")

    def fixed(self, count: int) -> int:
        """So many bits as a number."""
        if count > self._left:
            raise _NoHeader
        self._left -= count
        return (self._value >> self._left) & ((1 << count) - 1)

    def unsigned(self) -> int:
        """A number in Exp-Golomb code (9.1)."""
        zeros = 0
        while not self.fixed(1):
            zeros += 1
            if zeros > _LONGEST_CODE:
                raise _NoHeader
        return (1 << zeros) - 1 + self.fixed(zeros)

    def signed(self) -> int:
        """The same with a sign (9.1.1)."""
        code = self.unsigned()
        return (code + 1) // 2 if code % 2 else -(code // 2)


def _parameters_of(unit: bytes) -> _Parameters:
    """Read a sequence parameter set (7.3.2.1.1).

    Raises:
        _NoHeader: it is none.
    """
    bits = _Bits(unit)
    profile = bits.fixed(8)
    bits.fixed(16)
    bits.unsigned()
    separate = False
    if profile in _WITH_COLOUR:
        colour = bits.unsigned()
        separate = colour == 3 and bool(bits.fixed(1))
        bits.unsigned()
        bits.unsigned()
        bits.fixed(1)
        if bits.fixed(1):
            for number in range(12 if colour == 3 else 8):
                if bits.fixed(1):
                    _pass_scaling_list(bits, 16 if number < 6 else 64)
    frame_num_bits = bits.unsigned() + 4
    order = bits.unsigned()
    if order == 0:
        bits.unsigned()
    elif order == 1:
        bits.fixed(1)
        bits.signed()
        bits.signed()
        for _ in range(min(bits.unsigned(), 255)):
            bits.signed()
    bits.unsigned()
    gaps = bool(bits.fixed(1))
    bits.unsigned()
    bits.unsigned()
    if frame_num_bits > 16:
        raise _NoHeader
    return _Parameters(frame_num_bits, bool(bits.fixed(1)), separate, gaps)


def _pass_scaling_list(bits: _Bits, size: int) -> None:
    last = following = 8
    for _ in range(size):
        if following:
            following = (last + bits.signed()) % 256
        last = following or last


def _slice_of(unit: bytes, parameters: _Parameters) -> _Slice:
    """Read the beginning of a slice's header (7.3.3).

    Raises:
        _NoHeader: it is none.
    """
    bits = _Bits(unit[:_HEADER_BYTES])
    for _ in range(3):
        bits.unsigned()
    if parameters.separate_planes:
        bits.fixed(2)
    frame_num = bits.fixed(parameters.frame_num_bits)
    field = 0
    if not parameters.frames_only and bits.fixed(1):
        field = 1 + bits.fixed(1)
    return _Slice(frame_num, bool(unit[0] >> 5 & 3), unit[0] & 31 == _IDR, field)


def _by_start_codes(data: bytes) -> Iterator[bytes]:
    """The beginnings of units behind start codes (annex B), but for empty ones; who asks for no more, searches none."""
    at = data.find(_START)
    while at >= 0:
        unit = data[at + 3 : at + 3 + _UNIT_BYTES]
        end = unit.find(_START)
        unit = unit if end < 0 else unit[:end]
        if unit:
            yield unit
        at = data.find(_START, at + 3)


def _by_lengths(data: bytes, length_bytes: int) -> Iterator[bytes]:
    """The beginnings of units behind their lengths, but for empty ones.

    Raises:
        _NoHeader: the lengths are none: they lead beyond the end.
    """
    at = 0
    while at + length_bytes < len(data):
        length = int.from_bytes(data[at : at + length_bytes], "big")
        at += length_bytes
        if length:
            yield data[at : at + min(length, _UNIT_BYTES)]
        at += length
    if at > len(data):
        raise _NoHeader


def _of_record(record: bytes) -> Iterator[bytes]:
    """The sequence parameter sets of an MP4's record."""
    at = 6
    for _ in range(record[5] & 31):
        length = int.from_bytes(record[at : at + 2], "big")
        yield record[at + 2 : at + 2 + length]
        at += 2 + length
