"""A real RTSP server (RFC 2326): H.264 over RTP (RFC 6184) within the control connection, behind a password."""

from __future__ import annotations

import base64
import hashlib
import re
import socket
import socketserver
import struct
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import av
from av.bitstream import BitStreamFilterContext

CLOCK_HZ = 90_000
_NONCE, _REALM = "dcd98b7102dd2f0e8b11d0f600bfb0c093", "camera"
_LARGEST = 1400


@dataclass(frozen=True)
class Picture:
    """One coded picture: its NAL units, when it is shown (s from the first one), whether decoding may begin there."""

    units: Sequence[bytes]
    time_s: float
    key: bool


def pictures_of(recording: Path) -> list[Picture]:
    """The pictures of an H.264 recording, in decoding order."""
    found = []
    with av.open(str(recording)) as container:
        stream = container.streams.video[0]
        to_units = BitStreamFilterContext("h264_mp4toannexb", stream)
        for packet in container.demux(stream):
            for out in to_units.filter(packet if packet.size else None):
                units = [unit for unit in re.split(b"\x00\x00\x00?\x01", bytes(out)) if unit]
                assert out.pts is not None and out.time_base is not None
                found.append(Picture(units, float(out.pts * out.time_base), out.is_keyframe))
    return found


@dataclass
class Camera:
    """What a server shows, and how it behaves; change it while it runs.

    Attributes:
        pictures: sent one after the other, at their times, then from the first again.
        media: the body of the session description after its head; None: H.264.
        name: of the session, as the camera has encoded it.
        login: name and password, by digest; None: for everybody.
        jumps: of the picture with this number (counted over all rounds) the stamps of all after it move, s.
        silent_from: from the picture with this number on nothing is sent, and the connection stays open.
        breaks_after: the connection is broken after so many pictures, once.
        sent: when each picture was sent, Unix s, with its number and stamp in s.
        requests: the first line of each.
    """

    pictures: Sequence[Picture]
    media: str | None = None
    name: bytes = b"camera"
    login: tuple[str, str] | None = None
    jumps: Mapping[int, float] = field(default_factory=dict)
    silent_from: int | None = None
    breaks_after: int | None = None
    sent: list[tuple[float, int, float]] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    port: int = 0

    def url(self, login: str = "", path: str = "/live") -> str:
        return f"rtsp://{login}127.0.0.1:{self.port}{path}"

    def described(self) -> bytes:
        media = self.media
        if media is None:
            parameters = {unit[0] & 31: unit for unit in self.pictures[0].units if unit[0] & 31 in (7, 8)}
            sets = ",".join(base64.b64encode(parameters[kind]).decode() for kind in (7, 8))
            media = (
                "m=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\n"
                f"a=fmtp:96 packetization-mode=1;sprop-parameter-sets={sets}\r\na=control:track1\r\n"
            )
        lines = b"v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=%s\r\nc=IN IP4 0.0.0.0\r\nt=0 0\r\n"
        return lines % self.name + media.encode()


@contextmanager
def rtsp_server(camera: Camera, port: int = 0) -> Iterator[Camera]:
    """Serve until the block ends, which breaks all connections."""
    open_sockets: set[socket.socket] = set()

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            open_sockets.add(self.request)
            with suppress(OSError):
                _Session(camera, self.request, self.rfile).serve()

    class Server(socketserver.ThreadingTCPServer):
        allow_reuse_address = True
        daemon_threads = True
        block_on_close = False

    with Server(("127.0.0.1", port), Handler) as server:
        camera.port = server.server_address[1]
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        thread.start()
        try:
            yield camera
        finally:
            server.shutdown()
            for one in open_sockets:
                with suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)
            thread.join()


class _Session:
    def __init__(self, camera: Camera, connection: socket.socket, lines) -> None:
        self._camera, self._connection, self._lines = camera, connection, lines
        self._lock = threading.Lock()

    def serve(self) -> None:
        while first := self._lines.readline().decode().strip():
            headers = {}
            while line := self._lines.readline().decode().strip():
                name, _, value = line.partition(":")
                headers[name.lower()] = value.strip()
            self._camera.requests.append(first)
            method, url, _ = first.split()
            if not self._answer(method, url, headers):
                return

    def _answer(self, method: str, url: str, headers: Mapping[str, str]) -> bool:
        said, body, status = [f"CSeq: {headers['cseq']}"], b"", "200 OK"
        if self._camera.login and not self._knows(method, headers.get("authorization", "")):
            status = "401 Unauthorized"
            said.append(f'WWW-Authenticate: Digest realm="{_REALM}", nonce="{_NONCE}"')
        elif method == "OPTIONS":
            said.append("Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN")
        elif "/live" not in url:
            status = "404 Not Found"
        elif method == "DESCRIBE":
            body = self._camera.described()
            said += [f"Content-Base: {url}/", "Content-Type: application/sdp", f"Content-Length: {len(body)}"]
        elif method == "SETUP":
            said += ["Transport: RTP/AVP/TCP;unicast;interleaved=0-1", "Session: 1;timeout=60"]
        elif method in ("PLAY", "TEARDOWN", "GET_PARAMETER", "PAUSE"):
            said.append("Session: 1")
        else:
            status = "501 Not Implemented"
        with self._lock:
            self._connection.sendall(("\r\n".join([f"RTSP/1.0 {status}", *said, "", ""])).encode() + body)
        if method == "PLAY" and status.startswith("200"):
            threading.Thread(target=self._play, daemon=True).start()
        return method != "TEARDOWN"

    def _knows(self, method: str, authorization: str) -> bool:
        """Digest access authentication (RFC 2617) without a quality of protection."""
        given = dict(re.findall(r'(\w+)="([^"]*)"', authorization))
        user, password = self._camera.login or ("", "")
        secret = hashlib.md5(f"{user}:{_REALM}:{password}".encode()).hexdigest()
        asked = hashlib.md5(f"{method}:{given.get('uri', '')}".encode()).hexdigest()
        expected = hashlib.md5(f"{secret}:{_NONCE}:{asked}".encode()).hexdigest()
        return given.get("username") == user and given.get("response") == expected

    def _play(self) -> None:
        camera, begin = self._camera, time.monotonic()
        pictures = camera.pictures
        period_s = pictures[-1].time_s + (pictures[1].time_s - pictures[0].time_s)
        number, sequence, moved_s = 0, 0, 0.0
        with suppress(OSError):
            while camera.silent_from is None or number < camera.silent_from:
                if camera.breaks_after == number:
                    camera.breaks_after = None
                    self._connection.shutdown(socket.SHUT_RDWR)
                    return
                rounds, index = divmod(number, len(pictures))
                moved_s += camera.jumps.get(number, 0.0)
                shown_s = rounds * period_s + pictures[index].time_s
                time.sleep(max(begin + shown_s - time.monotonic(), 0.0))
                stamp = 1_000_000 + round((shown_s + moved_s) * CLOCK_HZ)
                camera.sent.append((time.time(), number, shown_s + moved_s))
                for payload, last in _payloads(pictures[index].units):
                    head = struct.pack(">BBHII", 0x80, 96 | (last << 7), sequence & 0xFFFF, stamp & 0xFFFFFFFF, 7)
                    with self._lock:
                        self._connection.sendall(struct.pack(">cBH", b"$", 0, len(head + payload)) + head + payload)
                    sequence += 1
                number += 1


def _payloads(units: Sequence[bytes]) -> Iterator[tuple[bytes, bool]]:
    """Payloads of RTP packets, and whether one is a picture's last: small units whole, large ones in pieces (FU-A)."""
    for k, unit in enumerate(units):
        of_last = k == len(units) - 1
        if len(unit) <= _LARGEST:
            yield unit, of_last
            continue
        pieces = [unit[1:][n : n + _LARGEST] for n in range(0, len(unit) - 1, _LARGEST)]
        for n, piece in enumerate(pieces):
            first, last = n == 0, n == len(pieces) - 1
            yield bytes([unit[0] & 0xE0 | 28, first << 7 | last << 6 | unit[0] & 31]) + piece, of_last and last
