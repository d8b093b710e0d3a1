"""Files that are no videos and name others: what FFmpeg would follow."""

from __future__ import annotations

SCHEMES = ("http", "https", "tcp", "rtmp", "rtsp", "ftp", "gopher", "tls")


def names(port: int) -> list[str]:
    """Names of files that FFmpeg, given them as they are, takes for addresses of this machine."""
    return [f"{scheme}:127.0.0.1:{port}?.mp4" for scheme in SCHEMES]


def playlists(address: str) -> dict[str, bytes]:
    """Contents that name `address`, a URL or a path, in every way that FFmpeg knows."""
    hls = f"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n{address}\n#EXT-X-ENDLIST\n"
    key = f'#EXT-X-KEY:METHOD=AES-128,URI="{address}"\n#EXTINF'
    sdp = "c=IN IP4 127.0.0.1\nt=0 0\nm=video 9 RTP/AVP 96\na=rtpmap:96 H264/90000\n"
    dash = (
        '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011" profiles="urn:mpeg:dash:profile:'
        f'isoff-main:2011"><Period><AdaptationSet><Representation><BaseURL>{address}</BaseURL>'
        "</Representation></AdaptationSet></Period></MPD>"
    )
    stream_like = b"".join(
        b"G" + f"{sdp if i == 0 else ''}".encode().ljust(186, b"x") + b"\n" for i in range(8)
    )
    return {
        "hls": hls.encode(),
        "hls-bom": b"\xef\xbb\xbf" + hls.encode(),
        "hls-key": hls.replace("#EXTINF", key).encode(),
        "concat": f"ffconcat version 1.0\nfile {address}\n".encode(),
        "sdp": b"v=0\n" + sdp.encode(),
        "dash": dash.encode(),
        "sdp-as-a-transport-stream": stream_like,
        "sdp-after-a-signature": b"OggS\n" + sdp.encode(),
        "reference": f"[Reference]\nRef1={address}\n".encode(),
    }
