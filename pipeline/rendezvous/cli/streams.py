"""Printing never fails, whatever the encoding of a terminal or pipe can express."""

from __future__ import annotations

import codecs
import io
import sys

_IN_ASCII = {
    "°": " deg",
    "±": "+-",
    "²": "^2",
    "³": "^3",
    "·": "*",
    "×": "x",
    "−": "-",
    "–": "-",
    "—": "-",
    "→": "->",
    "≤": "<=",
    "≥": ">=",
    "σ": "sigma",
    "θ": "theta",
    "µ": "u",
    "μ": "u",
    "…": "...",
    "’": "'",
}


def spell_out_what_the_encoding_lacks() -> None:
    """Make stdout and stderr print `45 deg` where they cannot print `45°`, and escape what else they lack."""
    codecs.register_error("spelt-out", _spelt_out)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="spelt-out")


def _spelt_out(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    lacking = error.object[error.start : error.end]
    return "".join(_IN_ASCII.get(sign, ascii(sign)[1:-1]) for sign in lacking), error.end
