"""Pictures of addresses that the camera of a phone reads."""

from __future__ import annotations

import io

import segno


def qr_svg(text: str) -> bytes:
    """Return a QR code as an SVG picture."""
    out = io.BytesIO()
    segno.make(text, micro=False).save(out, kind="svg", scale=6, border=3, dark="#000", light="#fff")
    return out.getvalue()


def qr_terminal(text: str) -> str:
    """Return a QR code in characters."""
    out = io.StringIO()
    segno.make(text, micro=False).terminal(out, compact=True)
    return out.getvalue()
